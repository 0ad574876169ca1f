"""The table of fields: every saved value is checked before anything is written, and nothing moves in a way that is not known."""

import pytest
import torch
import warp as wp

from maniskill_grpd.physics import Solver, box, cloth, square_outline
from maniskill_grpd.physics.fields import FIELDS, Field

SAVED = [name for name, field in FIELDS.items() if field.is_saved]


@pytest.fixture(scope="module")
def solver():
    models = [cloth(square_outline(0.2), num_nodes=num_nodes) for num_nodes in (9, 16)]
    solver = Solver(models, 3, 2, colliders=[box(0.1, 0.1, 0.1)], num_threads=1)
    solver.reset(torch.arange(3), gripper_nodes=torch.tensor([0, -1]), variants=torch.tensor([0, 1, 0]))
    return solver


def bad_values(name: str) -> list[float]:
    field = FIELDS[name]
    values = [float("nan"), float("inf")]
    if field.low > -float("inf"):
        values += [field.low - 1.0, -7.0]
    if field.is_positive:
        values.append(0.0)
    if field.high != float("inf"):
        values += [1e3, 1e9]
    if field.dtype in (wp.int32, wp.bool):
        values.append(0.5)
    if field.unit:
        values += [5.0, 0.0]
    return values


@pytest.mark.parametrize("name", SAVED)
def test_an_impossible_value_in_any_place_is_refused_by_name_and_changes_nothing(solver, name):
    before = solver.state()
    for value in bad_values(name):
        for column in {0, before[name].shape[1] - 1}:
            state = {key: tensor.clone() for key, tensor in before.items()}
            state[name][1] = state[name][1].abs() if FIELDS[name].unit else state[name][1]
            state[name][1, column] = value
            if FIELDS[name].unit and value == 0.0:
                state[name][1] = 0.0
            if FIELDS[name].unit == 3 and column == 3:
                continue  # the offset of a plane is free
            state["positions"][0] += 1.0  # fits, and must not be written either
            with pytest.raises(ValueError, match=name):
                solver.set_state(state)
            assert all(torch.equal(tensor, before[key]) for key, tensor in solver.state().items()), (name, value)


@pytest.mark.parametrize("name", SAVED)
def test_what_the_solver_says_of_itself_is_accepted(solver, name):
    state = solver.state()
    solver.set_state(state)
    assert torch.equal(solver.state()[name], state[name])


def test_a_gripper_holds_nodes_of_the_variant_of_its_world_only(solver):
    state = solver.state()
    state["gripper_nodes"][:, 1] = torch.tensor([8.0, 15.0, 8.0])
    solver.check_state(state)
    state["gripper_nodes"][0, 1] = 9.0
    with pytest.raises(ValueError, match=r"'gripper_nodes' must be a whole number in \[-1, 15\], or 8"):
        solver.check_state(state)


def test_missing_unknown_and_misshapen_fields_are_refused(solver):
    state = solver.state()
    with pytest.raises(ValueError, match="lacks"):
        solver.check_state({name: state[name] for name in SAVED[1:]})
    with pytest.raises(ValueError, match="has no"):
        solver.check_state({**state, "other": state["friction"]})
    with pytest.raises(ValueError, match=r"'positions' must be \(1, 48\)"):
        solver.check_state(state, torch.tensor([0]))


def test_a_field_that_moves_in_no_known_way_cannot_be_made():
    with pytest.raises(ValueError, match="moves as one of"):
        Field(dtype=wp.vec3, moves="somehow")
    with pytest.raises(TypeError, match="moves"):
        Field(dtype=wp.vec3)


def test_the_kernel_shares_the_memory_of_every_field_with_a_struct(solver):
    """What is written into a tensor is what the kernel reads: all fields of its structs are set."""
    _, colliders, _, worlds, *_ = solver._uploaded
    structs = {"worlds": worlds, "colliders": colliders}
    for name, (field, tensor) in solver.fields.items():
        if field.struct is not None:
            assert getattr(structs[field.struct], name.removeprefix("collider_")).ptr == tensor.data_ptr(), name


def test_more_worlds_than_fit_into_memory_are_refused_with_what_they_need():
    with pytest.raises(ValueError, match=r"1000000000 worlds need \d+\.\d GiB for their state alone, cpu has"):
        Solver(cloth(square_outline(0.2), num_nodes=9), 10**9)


def test_the_memory_of_a_field_is_that_of_its_tensor(solver):
    sizes = {
        "nodes": 16,
        "sheet_edges": max(len(model.edges) for model in solver.models if not model.is_rope),
        "grippers": 2,
        "colliders": 1,
    }
    for name, (field, tensor) in solver.fields.items():
        assert 3 * field.num_bytes(sizes) == tensor.numel() * tensor.element_size(), name
