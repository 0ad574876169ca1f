"""How far a curve winds around an axis, and the shortest one that does."""

from __future__ import annotations

import math

import torch


def arms_from_axis(points: torch.Tensor, origin: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return the vectors from an axis, and at right angles to it, to points.

    Args:
        points: (B, n, 3) [m].
        origin: A point of the axis, (B, 3) [m].
        axis: Unit vector along the axis, (B, 3).

    Returns:
        (B, n, 3) [m].
    """
    offsets = points - origin[:, None]
    return offsets - (offsets * axis[:, None]).sum(-1, keepdim=True) * axis[:, None]


def angles_between(first: torch.Tensor, second: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return the angles from arms to other arms, counter-clockwise about the axis, in (-pi, pi].

    Args:
        first: Arms of an axis, (B, n, 3) [m].
        second: Arms of the same axis, (B, n, 3) [m].
        axis: Unit vector along the axis, (B, 3).

    Returns:
        (B, n) [rad].
    """
    sine = (torch.linalg.cross(first, second) * axis[:, None]).sum(-1)
    return torch.atan2(sine, (first * second).sum(-1))


def turning_angles(arms: torch.Tensor, mask: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return the angle by which each segment of a curve turns about an axis, counter-clockwise positive.

    Exact for straight segments that do not meet the axis. The sum over a curve is what it winds, whatever way it takes and however
    unevenly its nodes lie: for a closed curve 2 pi times an integer.

    Args:
        arms: Arms of the nodes in their order along the curve, (B, N, 3) [m].
        mask: True for nodes, False for the padding behind them, (B, N) bool.
        axis: Unit vector along the axis, (B, 3).

    Returns:
        (B, N - 1) [rad]; 0 in the padding.

    Limitations: a node on the axis has no direction, and a segment through the axis turns by pi to either side.
    """
    angles = angles_between(arms[:, :-1], arms[:, 1:], axis)
    return torch.where(mask[:, 1:], angles, 0.0)


def winding_number(arms: torch.Tensor, mask: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
    """Return how often a curve goes around an axis, (B,), counter-clockwise positive; arguments as for `turning_angles`."""
    return turning_angles(arms, mask, axis).sum(dim=1) / (2.0 * math.pi)


def taut_curve(
    arms: torch.Tensor, turned: torch.Tensor, radius: torch.Tensor, axis: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the length and the ends' directions of the shortest curve that turns around a cylinder.

    Across the axis, the shortest curve from an end at the distance r_1 to one at r_2 that turns by phi around a cylinder of radius
    rho is two tangents and an arc,

        sqrt(r_1^2 - rho^2) + sqrt(r_2^2 - rho^2) + rho (|phi| - acos(rho / r_1) - acos(rho / r_2)),

    if the last term is positive; if not, it does not touch the cylinder. Its length grows at the rate 1 when an end moves against
    the direction in which the curve leaves it.

    Args:
        arms: Arms of the two ends, (B, 2, 3) [m].
        turned: Angle phi from the first to the second, (B,) [rad].
        radius: Radius rho, (B,) [m].
        axis: Unit vector along the axis, (B, 3).

    Returns:
        Length across the axis (B,) [m], 0 where the curve does not touch the cylinder, and the unit vectors along which it arrives
        at each of its ends, (B, 2, 3).
    """
    distance = torch.maximum(torch.linalg.vector_norm(arms, dim=-1), radius[:, None])
    tangent = (distance.square() - radius[:, None].square()).clamp(min=0.0).sqrt()
    arc = turned.abs() - torch.acos(radius[:, None] / distance).sum(dim=1)
    length = torch.where(arc > 0.0, tangent.sum(dim=1) + radius * arc, 0.0)
    outward = torch.nn.functional.normalize(arms, dim=-1)
    sideways = torch.linalg.cross(axis[:, None].expand_as(outward), outward)
    sense = torch.stack([-turned.sign(), turned.sign()], dim=1)
    share = radius[:, None] / distance
    directions = (tangent / distance)[..., None] * outward + (sense * share)[..., None] * sideways
    return length, directions
