"""Tugs: a spring outside the grippers pulls one node of one world."""

import numpy as np
import pytest
import torch

from maniskill_grpd.physics import Solver, cloth, rope, square_outline

STIFFNESS = 40.0


def hanging_cloth(num_worlds: int = 3) -> Solver:
    """Return cloths that hang from two corners without a table near them."""
    solver = Solver(cloth(square_outline(0.09), num_nodes=36), num_worlds, num_grippers=2)
    solver.plane[:, 3] = -10.0
    worlds = torch.arange(num_worlds)
    solver.reset(worlds, gripper_nodes=torch.tensor([0, 5]))
    return solver


def test_a_tugged_node_comes_to_its_point_and_the_other_worlds_do_not_notice():
    solver, untouched = hanging_cloth(), hanging_cloth()
    target = solver.positions[1, 35] + torch.tensor([-0.03, -0.03, -0.02])
    solver.tug(1, 35, target, STIFFNESS)
    for _ in range(60):
        solver.step()
        untouched.step()
    assert (solver.positions[1, 35] - target).norm() < 0.02
    assert (untouched.positions[1, 35] - target).norm() > 0.08
    assert torch.equal(solver.positions[[0, 2]], untouched.positions[[0, 2]])


@pytest.mark.parametrize("stiffness", [10.0, 40.0, 200.0])
def test_a_weight_stretches_the_spring_as_far_as_it_and_the_inertia_of_its_node_give_way(stiffness):
    """A cloth that nobody else holds hangs from the spring, lower by its weight over both in series."""
    solver = Solver(cloth(square_outline(0.3), num_nodes=36), 1, num_grippers=1)
    solver.plane[:, 3] = -10.0
    solver.damping[:] = 4.0
    target = solver.positions[0, 0].clone()
    solver.tug(0, 0, target, stiffness)
    for _ in range(300):
        solver.step()
    weight, substep = float((1.0 / solver.inverse_masses[0]).sum()) * 9.81, solver.control_dt / solver.substeps[0]
    extension = weight * (1.0 / stiffness + substep**2 * float(solver.inverse_masses[0, 0]))
    assert float(target[2] - solver.positions[0, 0, 2]) == pytest.approx(extension, rel=0.02)


def test_what_is_let_go_moves_as_if_nobody_had_come():
    solver, untouched = hanging_cloth(), hanging_cloth()
    solver.tug(0, 20, torch.ones(3), STIFFNESS)
    solver.let_go(torch.tensor([0]))
    solver.tug(2, 20, torch.ones(3), STIFFNESS)
    solver.reset(torch.tensor([2]), gripper_nodes=torch.tensor([0, 5]))
    for _ in range(5):
        solver.step()
        untouched.step()
    assert torch.equal(solver.positions, untouched.positions)


def test_held_nodes_stay_with_their_gripper():
    solver = hanging_cloth(1)
    solver.tug(0, 0, torch.tensor([1.0, 1.0, 1.0]), STIFFNESS)
    before = solver.positions[0, 0].clone()
    solver.step()
    assert torch.equal(solver.positions[0, 0], before)


@pytest.mark.parametrize(
    ("world", "node", "target", "stiffness", "message"),
    [
        (3, 0, torch.zeros(3), 1.0, r"world must be in \[0, 2\]"),
        (0, 36, torch.zeros(3), 1.0, r"node must be in \[0, 35\]"),
        (0, -1, torch.zeros(3), 1.0, "node must be"),
        (0, 0, torch.tensor([0.0, float("nan"), 0.0]), 1.0, "three finite numbers"),
        (0, 0, torch.zeros(2), 1.0, "three finite numbers"),
        (0, 0, torch.zeros(3), 0.0, "stiffness"),
        (0, 0, torch.zeros(3), float("inf"), "stiffness"),
    ],
)
def test_a_wrong_tug_is_refused_and_nothing_changes(world, node, target, stiffness, message):
    solver = hanging_cloth()
    with pytest.raises(ValueError, match=message):
        solver.tug(world, node, target, stiffness)
    assert (solver.tug_nodes == -1).all()


def test_nodes_of_a_smaller_variant_end_where_it_ends():
    curve = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]])
    solver = Solver([rope(curve, num_nodes=8), rope(curve, num_nodes=5)], 2, num_grippers=1)
    solver.reset(torch.tensor([1]), variants=torch.tensor([1]))
    with pytest.raises(ValueError, match=r"node must be in \[0, 4\]"):
        solver.tug(1, 6, torch.zeros(3), STIFFNESS)
