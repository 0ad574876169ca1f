"""Where a cloth comes onto a hanger: its hole or its middle; and where it is held."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from maniskill_grpd.physics import Model, circle_outline
from maniskill_grpd.physics.mesh.outlines import contains, distance_to
from maniskill_grpd.tasks.geometry.cloth_shapes import cloth_outline

HOLE_RADII = (0.03, 0.1)
"""Smallest and largest radius of a hole [m]."""
SMALLEST_RIM = 0.03
"""How much cloth there must be around a hole [m]."""
RING_RADIUS = 0.05
"""Radius of the disc in the middle of a cloth without a hole [m]."""
SEARCH_STEP = 0.0025
"""Spacing at which a cloth is searched for its roomiest point [m]."""


def check_hole(name: str, area: float, radius: float) -> None:
    """Raise ValueError unless a round hole fits a cloth of a shape and an area [m^2].

    Args:
        name: One of `CLOTH_SHAPES`.
        area: Area of the outline [m^2].
        radius: Radius of the hole [m].
    """
    low, high = HOLE_RADII
    if not low <= radius <= high:
        raise ValueError(f"hole_radius must be in [{low}, {high}] m, so that a peg passes and its plate does not, got {radius}")
    room = _roomiest_point(cloth_outline(name, area))[1] - SMALLEST_RIM
    if radius > room:
        raise ValueError(f"hole_radius must be at most {room:.3f} m in a {name} of {area} m^2, got {radius}")


def hole_outline(name: str, area: float, radius: float) -> np.ndarray:
    """Return a round hole about the point of a cloth that is farthest from its outline, (P, 2) [m]."""
    centre, _ = _roomiest_point(cloth_outline(name, area))
    return circle_outline(radius, center=tuple(centre))


def ring_about_middle(model: Model) -> np.ndarray:
    """Return nodes around a disc of 5 cm radius about the centre of mass of a cloth, in order, counter-clockwise, (L,) int64."""
    points = model.rest_positions[:, :2].astype(np.float64)
    middle = np.average(points, axis=0, weights=model.masses)
    nodes = np.linalg.norm(points - circle_outline(RING_RADIUS, tuple(middle))[:, None], axis=-1).argmin(axis=1)
    _, first = np.unique(nodes, return_index=True)
    return nodes[np.sort(first)].astype(np.int64)


def spread_corners(model: Model, num: int) -> np.ndarray:
    """Return the corners of a cloth that are farthest from each other in sum, in the order of the outline, (num,) int64.

    Raises:
        ValueError: If the cloth has fewer corners.
    """
    corners = model.node_sets["corners"]
    if num > len(corners):
        raise ValueError(f"grippers hold a cloth by its corners: one with {len(corners)} corners cannot take num_grippers={num}")
    points = model.rest_positions[corners]
    apart = np.linalg.norm(points[:, None] - points, axis=-1).astype(np.float64).round(6)
    best = max(combinations(range(len(corners)), num), key=lambda chosen: apart[np.ix_(chosen, chosen)].sum())
    return corners[list(best)]


def _roomiest_point(outline: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the point (2,) farthest from an outline [m], of several the one nearest to the origin, and its distance."""
    reach = int(np.abs(outline).max() / SEARCH_STEP)
    axis = SEARCH_STEP * np.arange(-reach, reach + 1)
    points = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    points = points[contains(outline, points)]
    room = distance_to(outline, points)
    best = int((room - 1e-3 * np.linalg.norm(points, axis=1)).argmax())
    return points[best], float(room[best])
