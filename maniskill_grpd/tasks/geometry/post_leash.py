"""How far apart the ends of a rope can be, the way around a post."""

from __future__ import annotations

import torch


def taut_length(distances: torch.Tensor, turned: torch.Tensor, radius: torch.Tensor) -> torch.Tensor:
    """Return the length of the shortest planar curve that turns by an angle around a disc at the origin.

    From an end at the distance r_1 to one at r_2, by the angle phi around a disc of radius rho, that is two tangents and an arc,

        sqrt(r_1^2 - rho^2) + sqrt(r_2^2 - rho^2) + rho (|phi| - acos(rho / r_1) - acos(rho / r_2)),

    if the last term is positive; if not, the curve does not touch the disc.

    Args:
        distances: Distances of both ends from the origin, (B, 2) [m]; those below rho count as rho.
        turned: Size of the angle phi, (B,) [rad].
        radius: Radius rho, (B,) [m].

    Returns:
        (B,) [m]; 0 where the curve does not touch the disc.
    """
    distances = torch.maximum(distances, radius[:, None])
    tangents = (distances.square() - radius[:, None].square()).sqrt()
    arc = turned - torch.acos(radius[:, None] / distances).sum(dim=1)
    return torch.where(arc > 0.0, tangents.sum(dim=1) + radius * arc, 0.0)


def limit_around_post(ends: torch.Tensor, turned: torch.Tensor, length: torch.Tensor, radius: torch.Tensor) -> torch.Tensor:
    """Draw the ends of a rope together until it is long enough to reach from one to the other around a post.

    The solver's leashes hold along straight lines. Around an obstacle the way is longer, and kinematic grippers would stretch the
    rope without limit until it slipped through. Each end moves by half of what is missing, back along the tangent on which the
    taut rope arrives at it: sqrt(r^2 - rho^2) / r of that inward, and rho / r of it back around the post. The other parts of the
    taut rope stay where they are.

    Args:
        ends: Where the two ends are to go, in a frame whose z is the post's axis, (B, 2, 3) [m].
        turned: Angle by which the rope turns about the axis from the first to the second, were they there, (B,) [rad].
        length: Length of the rope between them, (B,) [m]; infinite for no limit.
        radius: Distance of the taut rope's centre line from the axis, (B,) [m].

    Returns:
        (B, 2, 3) [m].

    Limitations: the post is taken for a cylinder, endlessly high. An end that is nearer to its point of contact than it moves
    leaves part of what is missing.
    """
    x, y, z = ends.unbind(-1)
    distances = torch.hypot(x, y)
    rise = z[:, 1] - z[:, 0]
    reach = (length.square() - rise.square()).clamp(min=0.0).sqrt()
    half = 0.5 * (taut_length(distances, turned.abs(), radius) - reach).clamp(min=0.0)
    sine = radius[:, None] / torch.maximum(distances, radius[:, None])
    inward = half[:, None] * (1.0 - sine.square()).sqrt() / distances.clamp(min=1e-9)
    sense = torch.stack([turned.sign(), -turned.sign()], dim=1)
    around = sense * half[:, None] * sine / distances.clamp(min=1e-9)
    return torch.stack([x - inward * x - around * y, y - inward * y + around * x, z], dim=-1)
