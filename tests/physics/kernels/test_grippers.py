"""Grippers do not pass through colliders, whatever they are told."""

import numpy as np
import pytest
import torch

from maniskill_grpd.physics import Solver, box, capsule, plane, rope, triangle_mesh

RADIUS = 0.01
ENDS = torch.tensor([0, 40])
OCTAHEDRON = np.concatenate([0.1 * np.eye(3), -0.1 * np.eye(3)])
OCTAHEDRON_FACES = [[0, 1, 2], [1, 3, 2], [3, 4, 2], [4, 0, 2], [1, 0, 5], [3, 1, 5], [4, 3, 5], [0, 4, 5]]


def rope_beside_a_post(num_worlds: int, colliders: list) -> Solver:
    """A rope along y at x = 0 in the air, held at both ends; obstacles stand where the caller puts them."""
    model = rope([[0.0, -0.4, 0.0], [0.0, 0.4, 0.0]], num_nodes=41, radius=RADIUS)
    solver = Solver(model, num_worlds, 2, colliders=colliders)
    solver.plane[:, 3] = -100.0
    solver.reset(torch.arange(num_worlds), solver.positions.clone(), ENDS)
    return solver


def distance_to_post(points: torch.Tensor, x: float, half_length: float, radius: float) -> torch.Tensor:
    """Distance of points (..., 3) from a vertical capsule at (x, -0.4)."""
    offset = points - torch.tensor([x, -0.4, 0.0])
    offset[..., 2] -= offset[..., 2].clamp(-half_length, half_length)
    return offset.norm(dim=-1) - radius


def way(start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
    """Points on the straight ways from start to end, both (B, 3), dense enough to hit 2 mm where the way is short."""
    return start + (end - start) * torch.linspace(0.0, 1.0, 2000)[:, None, None]


@pytest.mark.parametrize("step", [0.03, 0.4, 50.0])
def test_a_held_end_cannot_be_dragged_through_a_thin_post(step):
    """Rays that start on one side and aim all around the post of 2 mm: none may come closer than the rope is thick."""
    num_worlds = 64
    solver = rope_beside_a_post(num_worlds, [capsule(0.002, 0.5)])
    solver.collider_positions[:] = torch.tensor([0.1, -0.4, 0.0])
    angles = torch.linspace(-0.15, 0.15, num_worlds)
    aim = torch.stack([angles.cos(), angles.sin(), 0.2 * angles.sin()], dim=-1)
    blocked = (0.1 * angles.sin()).abs() < RADIUS
    for _ in range(8 if step < 0.1 else 3):
        before = solver.gripper_positions.clone()
        solver.gripper_targets.copy_(before + step * aim[:, None])
        solver.step()
        points = way(before[:, 0], solver.gripper_positions[:, 0])
        assert distance_to_post(points, 0.1, 0.5, 0.002).min() > RADIUS - 1e-5
        assert not solver.frozen.any()
    free = ~blocked & (angles > 0.0)  # the others are led past on the far side, where the taut rope hooks on the post
    assert (solver.gripper_positions[free, 0, 0] > 0.1).all()


@pytest.mark.parametrize("step", [0.03, 50.0])
def test_a_stopped_gripper_does_not_tear_the_rope(step):
    solver = rope_beside_a_post(1, [box(0.01, 0.2, 1.0)])
    solver.collider_positions[0, 0] = torch.tensor([0.05, -0.4, 0.0])
    for _ in range(12):
        solver.gripper_targets.copy_(solver.gripper_positions + torch.tensor([step, 0.0, 0.0]))
        solver.step()
        apart = (solver.gripper_positions[0, 0] - solver.gripper_positions[0, 1]).norm()
        assert apart < 0.8 * (1.0 + 1e-3)
    if step < 0.1:  # in one long step it slides along the wall until behind it
        assert solver.gripper_positions[0, 0, 0] == pytest.approx(0.04 - RADIUS, abs=0.02 * RADIUS)


def test_a_gripper_that_slides_off_one_collider_does_not_end_in_another():
    """A wedge of two inclined planes: whoever slides down one ends in the groove, outside of both."""
    solver = rope_beside_a_post(16, [plane(), plane()])
    s = np.sin(np.pi / 8)
    solver.collider_rotations[:, 0] = torch.tensor([np.cos(np.pi / 8), 0.0, s, 0.0])
    solver.collider_rotations[:, 1] = torch.tensor([np.cos(np.pi / 8), 0.0, -s, 0.0])
    solver.collider_positions[..., 2] = -0.3
    normals = torch.tensor([[np.sqrt(0.5), 0.0, np.sqrt(0.5)], [-np.sqrt(0.5), 0.0, np.sqrt(0.5)]], dtype=torch.float32)
    generator = torch.Generator().manual_seed(0)
    for _ in range(10):
        aim = torch.randn(16, 1, 3, generator=generator) - torch.tensor([0.0, 0.0, 1.0])
        solver.gripper_targets.copy_(solver.gripper_positions + aim)
        solver.step()
        heights = (solver.gripper_positions + torch.tensor([0.0, 0.0, 0.3])) @ normals.T
        assert heights.min() > RADIUS - 1e-5


@pytest.mark.parametrize("step", [0.03, 3.0])
def test_a_mesh_stops_grippers_from_all_sides(step):
    solver = rope_beside_a_post(64, [triangle_mesh(OCTAHEDRON, OCTAHEDRON_FACES)])
    generator = torch.Generator().manual_seed(0)
    direction = torch.randn(64, 3, generator=generator)
    solver.gripper_positions[:, 0] = 0.2 * direction / direction.norm(dim=-1, keepdim=True)
    solver.set_closed(torch.zeros(64, 2, dtype=torch.bool))
    for _ in range(8):
        before = solver.gripper_positions[:, 0].clone()
        solver.gripper_targets[:, 0] = before * (1.0 - step / before.norm(dim=-1, keepdim=True))
        solver.step()
        points = way(before, solver.gripper_positions[:, 0])
        height = (points.abs().sum(dim=-1) - 0.1) / np.sqrt(3.0)  # above its eight planes: less than the distance at its edges
        assert height.min() > 0.0
    assert height[-1].max() < 0.03 or step > 0.1


def test_a_gripper_inside_a_collider_can_leave_it():
    solver = rope_beside_a_post(1, [box(0.05, 0.05, 0.05)])
    solver.collider_positions[0, 0] = torch.tensor([0.02, -0.4, 0.0])
    for _ in range(4):
        solver.gripper_targets.copy_(solver.gripper_positions + torch.tensor([-0.03, 0.0, 0.0]))
        solver.step()
    assert solver.gripper_positions[0, 0, 0] < -0.03 - RADIUS


def test_an_invalid_target_still_freezes_its_world_alone():
    solver, healthy = (rope_beside_a_post(3, [capsule(0.002, 0.5)]) for _ in range(2))
    solver.gripper_targets[0, 0] = float("nan")
    solver.gripper_targets[1, 1, 2] = 1e6
    solver.step()
    healthy.step()
    assert solver.frozen.tolist() == [True, True, False]
    assert torch.equal(solver.positions[2], healthy.positions[2])
    assert torch.isfinite(solver.gripper_targets).all()
