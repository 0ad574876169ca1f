"""Posts that ropes are wrapped around: their sizes, as colliders and as solids to draw."""

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


@dataclass(frozen=True)
class Post:
    """A post along local z, its middle at the origin."""

    collider: Collider
    """What the rope touches."""
    circumradius: float
    """Radius of the smallest cylinder about its axis that contains it [m]."""
    section: np.ndarray
    """Its cross-section as a polygon, (P, 2) counter-clockwise [m]."""

    def solid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return vertices (V, 3) [m] and outward triangles (F, 3) to draw it with."""
        top = np.arange(len(self.section)) + len(self.section)
        bottom = top - len(self.section)
        vertices = np.concatenate([np.pad(self.section, ((0, 0), (0, 1)), constant_values=z * POST_HEIGHT) for z in (-0.5, 0.5)])
        after = np.roll(bottom, -1)
        sides = [np.stack([bottom, after, top], axis=1), np.stack([after, np.roll(top, -1), top], axis=1)]
        lids = [np.stack([top[:1].repeat(len(top) - 2), top[1:-1], top[2:]], axis=1)]
        lids.append(np.stack([bottom[:1].repeat(len(top) - 2), bottom[2:], bottom[1:-1]], axis=1))
        return vertices, np.concatenate(sides + lids)


def _regular_polygon(num_sides: int, circumradius: float) -> np.ndarray:
    angle = 2.0 * math.pi * (np.arange(num_sides) + 0.5) / num_sides
    return circumradius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


_HALF_HEIGHT = POST_HEIGHT / 2
_TRIANGLE = _regular_polygon(3, PRISM_CIRCUMRADIUS)
_BOX_CIRCUMRADIUS = BOX_SIDE / math.sqrt(2.0)

POSTS: dict[str, Post] = {
    "cylinder": Post(cylinder(CYLINDER_RADIUS, _HALF_HEIGHT), CYLINDER_RADIUS, _regular_polygon(32, CYLINDER_RADIUS)),
    "box": Post(box(BOX_SIDE / 2, BOX_SIDE / 2, _HALF_HEIGHT), _BOX_CIRCUMRADIUS, _regular_polygon(4, _BOX_CIRCUMRADIUS)),
    "prism": Post(prism(_TRIANGLE, _HALF_HEIGHT), PRISM_CIRCUMRADIUS, _TRIANGLE),
}
"""Posts by the name of their shape."""
