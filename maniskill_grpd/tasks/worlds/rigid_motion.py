"""Moving everything that the solver holds."""

from __future__ import annotations

import torch
from mani_skill.utils.geometry.rotation_conversions import matrix_to_quaternion, quaternion_multiply

from maniskill_grpd.physics import Solver


def move_solver(solver: Solver, rotation: torch.Tensor, translation: torch.Tensor) -> None:
    """Move all worlds rigidly, x -> R x + t: objects, grippers, table, obstacles and gravity.

    Args:
        solver: Changed in place.
        rotation: (B, 3, 3).
        translation: (B, 3) [m].
    """
    for points in (solver.positions, solver.gripper_positions, solver.gripper_targets, solver.collider_positions):
        points.copy_(points @ rotation.mT + translation[:, None])
    for vectors in (solver.velocities, solver.hold_offsets, solver.gripper_forces):
        vectors.copy_(vectors @ rotation.mT)
    solver.gravity.copy_((rotation @ solver.gravity[..., None])[..., 0])
    normal = (rotation @ solver.plane[:, :3, None])[..., 0]
    offset = solver.plane[:, 3:] + (normal * translation).sum(1, keepdim=True)
    solver.plane.copy_(torch.cat([normal, offset], dim=1))
    turns = matrix_to_quaternion(rotation)[:, None].expand_as(solver.collider_rotations)
    solver.collider_rotations.copy_(quaternion_multiply(turns, solver.collider_rotations))
