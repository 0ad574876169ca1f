"""Moving everything that the solver holds."""

from __future__ import annotations

import torch
from mani_skill.utils.geometry.rotation_conversions import matrix_to_quaternion, quaternion_multiply

from maniskill_grpd.physics import Solver

ROTATION_TOLERANCE = 1e-4
"""Largest deviation of R R^T from the identity that is rounding."""


def checked_motion(rotation: torch.Tensor, translation: torch.Tensor, num_worlds: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return rotations (B, 3, 3) and translations (B, 3) [m] from those of all worlds or one for all.

    Raises:
        ValueError: If a shape is wrong, a number is not finite or a matrix is no rotation.
    """
    for name, value, shape in (("rotation", rotation, (3, 3)), ("translation", translation, (3,))):
        if tuple(value.shape) not in (shape, (num_worlds, *shape)):
            raise ValueError(f"{name} must be {shape} or {(num_worlds, *shape)}, got {tuple(value.shape)}")
        if not torch.isfinite(value).all():
            raise ValueError(f"{name} must be finite, got {value.tolist()}")
    square = rotation.double() @ rotation.double().mT
    error = (square - torch.eye(3, dtype=square.dtype, device=square.device)).abs().amax()
    if error > ROTATION_TOLERANCE or (torch.linalg.det(rotation.double()) < 0.0).any():
        raise ValueError(f"rotation must be orthogonal with determinant 1, got {rotation.tolist()}")
    return rotation.expand(num_worlds, 3, 3), translation.expand(num_worlds, 3)


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
