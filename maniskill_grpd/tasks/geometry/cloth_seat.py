"""Where a cloth comes onto a hanger: its hole or its middle; and where it is held."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from maniskill_grpd.physics import Model, circle_outline
from maniskill_grpd.physics.mesh.outlines import as_points, centroid, contains, distance_to, signed_area
from maniskill_grpd.tasks.geometry.cloth_shapes import cloth_outline, in_cloth_frame
from maniskill_grpd.tasks.geometry.shape_registry import Shape, shape_label

HOLE_RADII = (0.03, 0.1)
"""Smallest and largest radius of a hole [m]."""
SMALLEST_RIM = 0.03
"""How much cloth there must be around a hole [m]."""
RING_RADIUS = 0.05
"""Radius of the disc in the middle of a cloth without a hole [m]."""
SEARCH_STEP = 0.0025
"""Spacing at which a cloth is searched for its roomiest point [m]."""


def hole_outline(shape: Shape, area: float, radius: float, center: np.ndarray | None = None) -> np.ndarray:
    """Return a round hole in a cloth, (P, 2) [m], in the coordinates of `cloth_outline`.

    Args:
        shape: One of `CLOTH_SHAPES`, or a polygon (P, 2) [m].
        area: Area of the outline of a shape with a name [m^2].
        radius: Radius of the hole [m].
        center: Its centre in the coordinates of the shape, (2,) [m]; by default the point that is farthest from the outline.

    Raises:
        ValueError: If the hole has a wrong radius or does not leave enough cloth around.
    """
    low, high = HOLE_RADII
    if not low <= radius <= high:
        raise ValueError(f"hole_radius must be in [{low}, {high}] m, so that a peg passes and its plate does not, got {radius}")
    outline, name = cloth_outline(shape, area), shape_label(shape)
    point, room = _roomiest_point(outline)
    if radius > room - SMALLEST_RIM:
        size = f"{signed_area(outline):.3g} m^2"
        raise ValueError(f"hole_radius must be at most {room - SMALLEST_RIM:.3f} m in a {name} of {size}, got {radius}")
    if center is not None:
        point = in_cloth_frame(shape, as_points([center], "hole_center", "two coordinates [m]"))[0]
        room = float(distance_to(outline, point[None])[0]) if contains(outline, point[None])[0] else 0.0
        if radius > room - SMALLEST_RIM:
            raise ValueError(
                f"hole_center must be hole_radius + {SMALLEST_RIM} m = {radius + SMALLEST_RIM:.3g} m or more inside the "
                f"outline of a {name}, got {np.asarray(center).tolist()}, {room:.3g} m inside"
            )
    return circle_outline(radius, center=tuple(point))


def check_middle(shape: Shape, area: float) -> None:
    """Raise ValueError unless the middle of a cloth, which comes onto a bar, is within the cloth."""
    outline = cloth_outline(shape, area)
    middle = centroid(outline)[None]
    room = float(distance_to(outline, middle)[0]) if contains(outline, middle)[0] else 0.0
    if room < RING_RADIUS:
        raise ValueError(
            f"the centre of mass of a cloth that is draped over a bar must be {RING_RADIUS} m or more inside its outline, got "
            f"{room:.3g} m for the {shape_label(shape)}"
        )


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
