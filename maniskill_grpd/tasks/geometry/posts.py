"""Posts that ropes are wrapped around."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from maniskill_grpd.physics import Collider, box, cylinder, prism

POST_HEIGHT = 0.15
"""Height of all posts [m]."""
CYLINDER_RADIUS = 0.06
"""Radius of the cylinder [m]."""
BOX_SIDE = 0.1
"""Side of the square cross-section of the box [m]."""
PRISM_CIRCUMRADIUS = 0.08
"""Distance of the edges of the triangular prism from its axis [m]."""

_HALF_HEIGHT = POST_HEIGHT / 2
_ANGLES = 2.0 * math.pi * np.arange(3) / 3
_TRIANGLE = PRISM_CIRCUMRADIUS * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], axis=1)


@dataclass(frozen=True)
class Post:
    """A post along local z, its middle at the origin."""

    collider: Collider
    """What the rope touches."""
    circumradius: float
    """Radius of the smallest cylinder about its axis that contains it [m]."""


POSTS: dict[str, Post] = {
    "cylinder": Post(cylinder(CYLINDER_RADIUS, _HALF_HEIGHT), CYLINDER_RADIUS),
    "box": Post(box(BOX_SIDE / 2, BOX_SIDE / 2, _HALF_HEIGHT), BOX_SIDE / math.sqrt(2.0)),
    "prism": Post(prism(_TRIANGLE, _HALF_HEIGHT), PRISM_CIRCUMRADIUS),
}
"""Posts by the name of their shape."""
