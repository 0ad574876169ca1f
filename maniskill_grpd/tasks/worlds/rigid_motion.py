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
    """Move all worlds rigidly, x -> R x + t: every field of the state in its own way.

    Args:
        solver: Changed in place.
        rotation: (B, 3, 3).
        translation: (B, 3) [m].
    """
    for field, tensor in solver.fields.values():
        rows = tensor.view(solver.num_worlds, tensor[0].numel() // field.num_components, field.num_components)
        rows.copy_(MOTIONS[field.moves](rows, rotation, translation))


def _move_positions(positions: torch.Tensor, rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
    return positions @ rotation.mT + translation[:, None]


def _move_vectors(vectors: torch.Tensor, rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
    return vectors @ rotation.mT


def _move_planes(planes: torch.Tensor, rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
    normals = planes[..., :3] @ rotation.mT
    return torch.cat([normals, planes[..., 3:] + (normals * translation[:, None]).sum(-1, keepdim=True)], dim=-1)


def _move_rotations(rotations: torch.Tensor, rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
    return quaternion_multiply(matrix_to_quaternion(rotation)[:, None].expand_as(rotations), rotations)


def _keep(scalars: torch.Tensor, rotation: torch.Tensor, translation: torch.Tensor) -> torch.Tensor:
    return scalars


MOTIONS = {
    "position": _move_positions,
    "vector": _move_vectors,
    "plane": _move_planes,
    "rotation": _move_rotations,
    "scalar": _keep,
}
"""How fields change, by `Field.moves`; every kind there is has to be here."""
