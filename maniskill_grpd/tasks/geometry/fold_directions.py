"""Which creases a cloth can be folded along, by the number of grippers."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch

from maniskill_grpd.physics.mesh.outlines import signed_area
from maniskill_grpd.tasks.geometry.crease import area_beyond, corner_directions, hull_corners, is_convex, side_directions


class CreaseRange(NamedTuple):
    """The creases of one number of grippers."""

    directions: Callable[[np.ndarray], np.ndarray]
    """Gives the directions (S, 2) about which the normals of the creases of an outline (P, 2) are drawn."""
    deviation: float
    """Largest angle between a normal and its direction [rad]."""
    grip_angles: tuple[float, ...]
    """Each gripper holds the node farthest in a direction this far from the crease's normal [rad]."""


CREASES = {
    1: CreaseRange(corner_directions, np.deg2rad(10.0), (0.0,)),
    2: CreaseRange(side_directions, np.deg2rad(20.0), (-np.deg2rad(25.0), np.deg2rad(25.0))),
}
"""Creases by the number of grippers."""
MOVING_SHARES = (0.25, 0.5)
"""Smallest and largest share of the cloth's area that is to move."""
TRIED_NORMALS = 9
"""Normals between the outermost ones at which a direction is tried."""


def fold_directions(outline: np.ndarray, num_grippers: int, name: str) -> np.ndarray:
    """Return the directions about which the normals of creases are drawn, unit vectors (S, 2).

    Directions in which the held points are beyond the crease only where more than half of the cloth is are left out: the long
    sides of a strip.

    Args:
        outline: Counter-clockwise polygon, (P, 2) [m].
        num_grippers: 1 or 2.
        name: What to call the cloth in messages.

    Raises:
        ValueError: If there is no such direction, or one gripper is to fold an outline that is not convex.
    """
    creases = CREASES[num_grippers]
    if num_grippers == 1 and not is_convex(outline):
        raise ValueError(
            f"a cloth like the {name} needs two grippers: what is beyond a crease of an outline that is not convex is not "
            "carried by one point"
        )
    directions = creases.directions(outline)
    shares = np.array([_smallest_share(outline, direction, creases) for direction in directions])
    if not (shares < MOVING_SHARES[1]).any():
        raise ValueError(
            f"a cloth like the {name} cannot be folded: wherever the held points are beyond the crease, {shares.min():.0%} of "
            f"the area or more is, and at most {MOVING_SHARES[1]:.0%} is to move"
        )
    return directions[shares < MOVING_SHARES[1]]


def _smallest_share(outline: np.ndarray, direction: np.ndarray, creases: CreaseRange) -> float:
    """Return the share of the area that is beyond a crease through the nearest held point, at the worst normal of a direction."""
    at = np.arctan2(direction[1], direction[0])
    angles = at + creases.deviation * np.linspace(-1.0, 1.0, TRIED_NORMALS)
    corners = outline[hull_corners(outline)]
    held = [corners[(corners @ _unit(angles + grip).T).argmax(axis=0)] for grip in creases.grip_angles]
    normals = _unit(angles)
    nearest = np.min([(points * normals).sum(axis=1) for points in held], axis=0)
    outlines = torch.as_tensor(outline).expand(len(angles), -1, -1)
    beyond = area_beyond(outlines, torch.as_tensor(normals), torch.as_tensor(nearest))
    return float(beyond.max()) / signed_area(outline)


def _unit(angles: np.ndarray) -> np.ndarray:
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
