"""Rigid motions of sets of points."""

from __future__ import annotations

import torch


def fit_rotation(layout: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """Return the rotations that bring layouts closest to points (Kabsch; Umeyama 1991, doi:10.1109/34.88573), (B, 3, 3).

    Layouts in a plane determine a rotation too, layouts on a line do not.

    Args:
        layout: Points with their mean at the origin, (B, A, 3).
        points: Where they are, up to a common translation, (B, A, 3).
    """
    spokes = points - points.mean(dim=1, keepdim=True)
    left, _, right = torch.linalg.svd(spokes.mT @ layout)
    handedness = torch.ones_like(left[..., 0])
    handedness[..., 2] = torch.linalg.det(left @ right)
    return left @ (handedness[..., None] * right)


def shortest_turn(start: torch.Tensor, end: torch.Tensor) -> torch.Tensor:
    """Return the smallest rotation that takes one direction to another, as axis times angle, (B, 3) [rad].

    Args:
        start: Unit vectors, (B, 3).
        end: Unit vectors, (B, 3), not opposite to them.
    """
    cross = torch.linalg.cross(start, end)
    sine = torch.linalg.vector_norm(cross, dim=-1, keepdim=True)
    angle = torch.atan2(sine, (start * end).sum(-1, keepdim=True))
    return cross * (angle / sine.clamp(min=1e-9))
