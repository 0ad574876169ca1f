"""Closed polygons in space: where their middle is, which way they face, and what passes through them.

Loops are (B, L, 3) [m], their last point joined to the first. Repeated points change nothing, so that loops of different
lengths are padded by repeating a point.
"""

from __future__ import annotations

import torch


def loop_centre(loop: torch.Tensor) -> torch.Tensor:
    """Return the mean of the points of the curve, weighted by length, (B, 3) [m]."""
    following = loop.roll(-1, dims=1)
    length = torch.linalg.vector_norm(following - loop, dim=-1, keepdim=True)
    return (0.5 * (loop + following) * length).sum(1) / length.sum(1).clamp(min=1e-12)


def loop_area(loop: torch.Tensor) -> torch.Tensor:
    """Return the area vector, half the sum of x_k x x_k+1, (B, 3) [m^2].

    It is the same for every surface that the loop bounds; a flat loop is counter-clockwise as seen from its tip.
    """
    spokes = loop - loop.mean(dim=1, keepdim=True)
    return 0.5 * torch.linalg.cross(spokes, spokes.roll(-1, dims=1)).sum(1)


def winding_about_axis(loop: torch.Tensor, origin: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return how often the loop winds about a straight line, counter-clockwise along its direction, (B,).

    It is a whole number up to rounding, and not 0 exactly where the line passes through the loop.

    Args:
        loop: (B, L, 3) [m].
        origin: A point of the line, (B, 3) [m].
        axis: Its direction, unit vectors (B, 3).
    """
    spokes = loop - origin[:, None]
    spokes = spokes - (spokes * axis[:, None]).sum(-1, keepdim=True) * axis[:, None]
    following = spokes.roll(-1, dims=1)
    sine = (torch.linalg.cross(spokes, following) * axis[:, None]).sum(-1)
    return torch.atan2(sine, (spokes * following).sum(-1)).sum(1) / (2.0 * torch.pi)
