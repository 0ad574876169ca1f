"""How far apart two grippers that hold a rope can be, the way around a post."""

from __future__ import annotations

import torch

from maniskill_grpd.tasks.winding import angles_between, arms_from_axis, taut_curve

ITERATIONS = 4
"""Corrections of the targets. One would do if the curve's ends kept their direction."""


def limit_around_post(
    targets: torch.Tensor,
    turned: torch.Tensor,
    length: torch.Tensor,
    radius: torch.Tensor,
    origin: torch.Tensor,
    axis: torch.Tensor,
) -> torch.Tensor:
    """Draw two ends of a rope together until it is long enough to reach from one to the other around a post.

    The solver's leashes hold along straight lines. Around an obstacle the way is longer, and kinematic grippers would stretch the
    rope without limit until it slipped through. Each end moves against the taut rope by half of what is missing.

    Args:
        targets: Where the ends are to go, (B, 2, 3) [m].
        turned: Angle by which the rope turns about the axis from the first to the second target, (B,) [rad].
        length: Length of the rope between the ends, (B,) [m]; infinite for no limit.
        radius: Distance of the taut rope's centre line from the axis, (B,) [m].
        origin: A point of the axis, (B, 3) [m].
        axis: Unit vector along the axis, (B, 3).

    Returns:
        (B, 2, 3) [m].
    """
    for _ in range(ITERATIONS):
        arms = arms_from_axis(targets, origin, axis)
        taut, directions = taut_curve(arms, turned, radius, axis)
        rise = ((targets[:, 1] - targets[:, 0]) * axis).sum(-1)
        missing = taut - (length.square() - rise.square()).clamp(min=0.0).sqrt()
        targets = targets - 0.5 * missing.clamp(min=0.0)[:, None, None] * directions
        moved = angles_between(arms, arms_from_axis(targets, origin, axis), axis)
        turned = turned + moved[:, 1] - moved[:, 0]
    return targets
