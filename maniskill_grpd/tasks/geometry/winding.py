"""How far a planar curve winds around the origin."""

from __future__ import annotations

import math

import torch


def angles_between(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """Return the angles from points to other points, seen from the origin, in (-pi, pi]; counter-clockwise is positive.

    Args:
        first: (..., 2) [m].
        second: (..., 2) [m].

    Returns:
        (...) [rad]. Computed in double precision: in single precision the last bit of an arc tangent depends on its place in the
        batch, by whether it is computed in a vector register.
    """
    (x, y), (u, v) = first.double().unbind(-1), second.double().unbind(-1)
    return torch.atan2(x * v - y * u, x * u + y * v).to(first.dtype)


def turning_angles(points: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return the angle by which each segment of a curve turns about the origin, counter-clockwise positive.

    Exact for straight segments that do not meet the origin. The sum over a curve is what it winds, whatever way it takes and
    however unevenly its nodes lie: for a closed curve 2 pi times an integer.

    Args:
        points: Nodes in their order along the curve, (B, N, 2) [m].
        mask: True for nodes, False for the padding behind them, (B, N) bool.

    Returns:
        (B, N - 1) [rad]; 0 in the padding.

    Limitations: a node at the origin has no direction, and a segment through the origin turns by pi to either side.
    """
    return torch.where(mask[:, 1:], angles_between(points[:, :-1], points[:, 1:]), 0.0)


def winding_number(points: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return how often a curve goes around the origin, (B,), counter-clockwise positive; arguments as for `turning_angles`."""
    return turning_angles(points, mask).sum(dim=1) / (2.0 * math.pi)
