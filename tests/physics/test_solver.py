"""What must hold for any batch of worlds: determinism, isolation, symmetry, strength and recovery."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.physics import RopeMaterial, Solver, resample_polyline, rope, sphere

MAX_STEP = 0.03
GRIPPER_NODES = torch.tensor([0, 10, 30, 40])


def lying_rope(num_nodes: int = 41):
    return rope([[-0.4, 0.0, 0.01], [0.4, 0.0, 0.01]], num_nodes=num_nodes)


def held_solver(num_worlds: int, **options) -> Solver:
    solver = Solver(lying_rope(), num_worlds, 4, **options)
    solver.reset(torch.arange(num_worlds), solver.positions.clone(), GRIPPER_NODES)
    return solver


def random_moves(num_worlds: int, num_steps: int, seed: int = 0) -> torch.Tensor:
    """Full-speed gripper moves that keep their direction for ten steps, (T, B, A, 3), the same for a world in any batch."""
    moves = []
    for world in range(num_worlds):
        generator = torch.Generator().manual_seed(1000 * seed + world)
        direction = torch.randn(num_steps // 10 + 1, 4, 3, generator=generator).repeat_interleave(10, dim=0)[:num_steps]
        moves.append(MAX_STEP * direction / direction.norm(dim=-1, keepdim=True))
    return torch.stack(moves, dim=1)


def drive(solver: Solver, moves: torch.Tensor) -> None:
    for move in moves:
        solver.gripper_targets.copy_(solver.gripper_positions + move)
        solver.gripper_targets[..., 2].clamp_(min=0.01)
        solver.step()


def assert_same_state(a: Solver, b: Solver, worlds_a=slice(None), worlds_b=slice(None)) -> None:
    state_a, state_b = a.state(), b.state()
    for name in state_a:
        assert torch.equal(state_a[name][worlds_a], state_b[name][worlds_b]), name


def test_same_actions_give_bitwise_equal_trajectories():
    a, b = held_solver(8), held_solver(8)
    moves = random_moves(8, 20)
    drive(a, moves)
    drive(b, moves)
    assert_same_state(a, b)


@pytest.mark.parametrize("num_threads", [1, 2, 5])
def test_a_world_depends_neither_on_the_batch_nor_on_the_threads(num_threads):
    moves = random_moves(37, 20)
    batch = held_solver(37, num_threads=num_threads)
    drive(batch, moves)
    for world in (0, 17, 36):
        alone = held_solver(1)
        drive(alone, moves[:, world : world + 1])
        assert_same_state(alone, batch, worlds_b=slice(world, world + 1))


def test_resetting_some_worlds_leaves_the_others_bitwise_unchanged():
    moves = random_moves(6, 30)
    disturbed, calm = held_solver(6), held_solver(6)
    drive(disturbed, moves[:15])
    drive(calm, moves[:15])
    disturbed.reset(torch.tensor([1, 4]), disturbed.positions[[0, 2]] + 0.1, GRIPPER_NODES)
    drive(disturbed, moves[15:])
    drive(calm, moves[15:])
    others = [0, 2, 3, 5]
    assert_same_state(disturbed, calm, others, others)
    assert not torch.equal(disturbed.positions[1], calm.positions[1])


def test_state_round_trip_continues_bitwise():
    moves = random_moves(4, 30)
    original = held_solver(4)
    drive(original, moves[:15])
    copy = Solver(lying_rope(), 4, 4)
    copy.set_state(original.state())
    drive(original, moves[15:])
    drive(copy, moves[15:])
    assert_same_state(original, copy)


def test_a_saved_state_does_not_change_with_the_solver():
    solver = held_solver(1)
    saved, rest = solver.state(), solver.model.rest_positions.copy()
    expected = {name: value.clone() for name, value in saved.items()}
    drive(solver, random_moves(1, 5))
    assert all(torch.equal(saved[name], expected[name]) for name in saved)
    np.testing.assert_array_equal(solver.model.rest_positions, rest)
    solver.set_state(saved)
    assert torch.equal(solver.positions[0], torch.as_tensor(rest))


def test_step_commutes_with_moving_the_whole_scene():
    """Rotating and translating rope, grippers, table and gravity rotates and translates the result, within float error."""
    rotation = torch.tensor(Rotation.random(random_state=3).as_matrix(), dtype=torch.float32)
    shift = torch.tensor([0.3, -0.2, 0.5])
    plain, moved = held_solver(4), Solver(lying_rope(), 4, 4)
    moved.gravity.copy_(plain.gravity @ rotation.T)
    normal = rotation @ torch.tensor([0.0, 0.0, 1.0])
    moved.plane.copy_(torch.cat([normal, (normal @ shift)[None]]).expand(4, 4))
    moved.reset(torch.arange(4), plain.positions @ rotation.T + shift, GRIPPER_NODES)
    for move in random_moves(4, 10):
        plain.gripper_targets.copy_(plain.gripper_positions + move)
        plain.gripper_targets[..., 2].clamp_(min=0.01)
        moved.gripper_targets.copy_(plain.gripper_targets @ rotation.T + shift)
        plain.step()
        moved.step()
    # Ropes on a table are dissipative, so rounding does not grow: a millimetre would already be a broken symmetry.
    torch.testing.assert_close(moved.positions, plain.positions @ rotation.T + shift, rtol=0.0, atol=2e-4)


def test_rope_keeps_its_length_when_dragged_at_full_speed():
    solver = held_solver(32)
    strains = []
    for move in random_moves(32, 100):
        drive(solver, move[None])
        lengths = (solver.positions[:, 1:] - solver.positions[:, :-1]).norm(dim=-1)
        strains.append((lengths / 0.02 - 1.0).abs())
    assert torch.quantile(torch.stack(strains)[::5].flatten(), 0.99) < 0.05
    assert not solver.frozen.any()


def test_a_taut_rope_keeps_its_length_when_dragged_sideways():
    """Its ends are pulled apart with all they have, to the end of their leash, while both are dragged to and fro."""
    num_worlds = 16
    solver = Solver(lying_rope(), num_worlds, 2)
    solver.plane[:, 3] = -100.0
    solver.reset(torch.arange(num_worlds), gripper_nodes=torch.tensor([0, 40]))
    strains = []
    for move in random_moves(num_worlds, 60):
        solver.gripper_targets.copy_(solver.gripper_positions + move[:, :1])
        solver.gripper_targets[:, 0, 0] -= MAX_STEP
        solver.gripper_targets[:, 1, 0] += MAX_STEP
        solver.step()
        strains.append((solver.positions[:, 1:] - solver.positions[:, :-1]).norm(dim=-1) / 0.02 - 1.0)
    # A gripper turns from -v to v = 0.6 m/s between two substeps of dt = 2.5 ms. Half the rope follows it within about one:
    # T = (rho L / 2) 2 v / dt = 9.6 N, a strain of T / EA = 2 %.
    assert torch.stack(strains).max() < 0.02
    assert not solver.frozen.any()


def test_a_slack_rope_is_bitwise_the_same_beside_a_taut_one():
    """The directions of the end of a substep are taken in worlds whose rope is taut, and change nothing in the others."""
    slack, both = Solver(lying_rope(), 1, 2), Solver(lying_rope(), 2, 2)
    slack.reset(torch.tensor([0]), gripper_nodes=torch.tensor([0, -1]))
    both.reset(torch.tensor([0]), gripper_nodes=torch.tensor([0, -1]))
    both.reset(torch.tensor([1]), gripper_nodes=torch.tensor([0, 40]))
    for _ in range(20):
        slack.gripper_targets[:, 0, 2] += 0.005
        both.gripper_targets[0, 0, 2] += 0.005
        both.gripper_targets[1, :, 1] += MAX_STEP
        slack.step()
        both.step()
    assert both.gripper_forces[1].norm(dim=-1).min() > 1.07  # the limit rho l^2 / (3 dt^2) [N]
    assert_same_state(slack, both, worlds_b=slice(0, 1))


def test_grippers_cannot_pull_the_rope_beyond_its_length():
    solver = held_solver(1)
    for _ in range(40):
        outwards = torch.tensor([[-MAX_STEP, 0.0, 0.0]] * 2 + [[MAX_STEP, 0.0, 0.0]] * 2)
        drive(solver, outwards[None, None])
    distances = (solver.gripper_positions[0, 1:] - solver.gripper_positions[0, :-1]).norm(dim=-1)
    torch.testing.assert_close(distances, torch.tensor([0.2, 0.4, 0.2]), rtol=1e-3, atol=0.0)


def test_held_nodes_follow_their_grippers_exactly():
    solver = held_solver(3)
    drive(solver, random_moves(3, 10))
    torch.testing.assert_close(solver.positions[:, GRIPPER_NODES], solver.gripper_positions, rtol=0.0, atol=1e-6)
    torch.testing.assert_close(solver.gripper_positions, solver.gripper_targets, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("poison", ["position", "velocity", "target"])
def test_a_world_that_turns_non_finite_is_frozen_alone_and_recovers_by_reset(poison):
    moves = random_moves(3, 20)
    sick, healthy = held_solver(3), held_solver(3)
    drive(sick, moves[:10])
    drive(healthy, moves[:10])
    before = sick.positions[1].clone()
    sick.gripper_targets.copy_(sick.gripper_positions)
    healthy.gripper_targets.copy_(healthy.gripper_positions)
    if poison == "position":
        sick.inverse_masses[1, 5] = float("nan")
    elif poison == "velocity":
        sick.velocities[1, 5] = float("inf")
    else:
        sick.gripper_targets[1, 2] = float("nan")
    sick.step()
    healthy.step()
    assert sick.frozen.tolist() == [False, True, False]
    assert torch.isfinite(sick.positions).all()
    assert torch.isfinite(sick.velocities).all()
    assert torch.equal(sick.positions[1], before)
    sick.step()
    healthy.step()
    assert_same_state(sick, healthy, [0, 2], [0, 2])

    sick.inverse_masses.copy_(healthy.inverse_masses)
    sick.reset(torch.tensor([1]), before[None], GRIPPER_NODES)
    drive(sick, moves[10:12])
    assert not sick.frozen.any()


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
@pytest.mark.gpu
def test_cuda_follows_the_cpu():
    moves = random_moves(16, 20)
    cpu, cuda = held_solver(16), Solver(lying_rope(), 16, 4, device="cuda")
    cuda.reset(torch.arange(16, device="cuda"), cpu.positions.cuda(), GRIPPER_NODES.cuda())
    for move in moves:
        drive(cpu, move[None])
        cuda.gripper_targets.copy_(cpu.gripper_targets)
        cuda.step()
    torch.testing.assert_close(cuda.positions.cpu(), cpu.positions, rtol=0.0, atol=2e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_worlds": 0}, "num_worlds"),
        ({"num_grippers": 0}, "num_grippers"),
        ({"substeps": 0}, "substeps"),
        ({"substeps": 2.5}, "substeps must be a whole number"),
        ({"control_dt": -1.0}, "control_dt"),
        ({"num_threads": 0}, "num_threads"),
    ],
)
def test_solver_refuses_numbers_out_of_range(options, message):
    with pytest.raises(ValueError, match=message):
        Solver(lying_rope(), **{"num_worlds": 1, **options})


def test_reset_refuses_wrong_shapes_and_non_finite_positions():
    solver = held_solver(2)
    with pytest.raises(ValueError, match=r"\(1, 41, 3\).*\(1, 40, 3\)"):
        solver.reset(torch.tensor([0]), torch.zeros(1, 40, 3))
    with pytest.raises(ValueError, match="finite"):
        solver.reset(torch.tensor([0]), torch.full((1, 41, 3), float("nan")))
    with pytest.raises(ValueError, match="lacks"):
        solver.set_state({"positions": solver.state()["positions"]})


@pytest.mark.parametrize(
    "options",
    [{"linear_density": 0.0}, {"stretch_stiffness": -1.0}, {"bend_stiffness": np.nan}, {"friction": -0.1}, {"damping": -1.0}],
)
def test_material_refuses_non_physical_values(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        RopeMaterial(**options)


def test_rope_refuses_degenerate_geometry():
    with pytest.raises(ValueError, match="positive length"):
        rope(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="num_nodes"):
        rope([[0.0, 0.0], [1.0, 0.0]], num_nodes=2)
    with pytest.raises(ValueError, match="radius"):
        rope([[0.0, 0.0], [1.0, 0.0]], radius=0.0)
    with pytest.raises(ValueError, match="shape"):
        rope([0.0, 1.0])


def test_resampled_polyline_has_equal_arc_steps_and_keeps_its_ends():
    curve = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
    points = resample_polyline(curve, 7)
    np.testing.assert_allclose(points[[0, -1]], curve[[0, -1]])
    np.testing.assert_allclose(np.linalg.norm(np.diff(points, axis=0), axis=1), 0.5)


def test_rope_mass_does_not_depend_on_resolution():
    masses = [rope([[0.0, 0.0], [0.8, 0.0]], num_nodes=n).masses.sum() for n in (20, 41, 200)]
    np.testing.assert_allclose(masses, 0.8 * RopeMaterial().linear_density, rtol=1e-5)


def test_every_tensor_of_a_saved_state_is_a_copy():
    """Also those that stay the same in most tests, such as gravity."""
    solver = held_solver(2, colliders=[sphere(0.02)])
    state = solver.state()
    kept = {name: value.clone() for name, value in state.items()}
    for name in state:
        tensor = getattr(solver, name)
        tensor.copy_(~tensor if tensor.dtype == torch.bool else tensor + 1)
    for name, value in state.items():
        assert torch.equal(value, kept[name]), name
