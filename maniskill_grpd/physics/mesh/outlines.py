"""Outlines of cloth: closed polygons in the plane, and what makes one valid."""

from __future__ import annotations

import numpy as np

# Turns sharper than this are corners [rad]; a circle needs at least 13 points to count as smooth.
CORNER_ANGLE = np.deg2rad(29.0)


def rectangle_outline(width: float, height: float) -> np.ndarray:
    """Return a rectangle about the origin, (4, 2) [m], counter-clockwise from the lower left corner."""
    return 0.5 * np.array([[-width, -height], [width, -height], [width, height], [-width, height]])


def square_outline(side: float) -> np.ndarray:
    """Return a square about the origin, (4, 2) [m]."""
    return rectangle_outline(side, side)


def _regular_outline(num_corners: int, radius: float, phase: float) -> np.ndarray:
    angles = phase + 2.0 * np.pi * np.arange(num_corners) / num_corners
    return radius * np.column_stack([np.cos(angles), np.sin(angles)])


def triangle_outline(side: float) -> np.ndarray:
    """Return an equilateral triangle about the origin, (3, 2) [m], its first edge along x."""
    return _regular_outline(3, side / np.sqrt(3.0), np.deg2rad(210.0))


def hexagon_outline(side: float) -> np.ndarray:
    """Return a regular hexagon about the origin, (6, 2) [m], its first edge along x."""
    return _regular_outline(6, side, np.deg2rad(240.0))


def circle_outline(radius: float, center: tuple[float, float] = (0.0, 0.0), num_points: int = 48) -> np.ndarray:
    """Return a circle as a polygon, (num_points, 2) [m]; also the usual hole."""
    return _regular_outline(num_points, radius, 0.0) + np.asarray(center)


def l_shape_outline(size: float, width: float | None = None) -> np.ndarray:
    """Return an L of two arms, (6, 2) [m], in a square box about the origin; by default arms are half as wide as the box."""
    width = 0.5 * size if width is None else width
    corners = [[0.0, 0.0], [size, 0.0], [size, width], [width, width], [width, size], [0.0, size]]
    return np.array(corners) - 0.5 * size


def signed_area(polygon: np.ndarray) -> float:
    """Return the area of a polygon (P, 2), positive if it runs counter-clockwise [m^2]."""
    x, y = (polygon - polygon[0]).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def contains(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which points (Q, 2) lie inside a polygon (P, 2), (Q,) bool, by counting the crossings of a ray."""
    start, end = polygon, np.roll(polygon, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    straddles = (start[:, 1] > y) != (end[:, 1] > y)
    rise = np.where(end[:, 1] == start[:, 1], 1.0, end[:, 1] - start[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) * (end[:, 0] - start[:, 0]) / rise
    return np.count_nonzero(straddles & (x < crossing), axis=1) % 2 == 1


def distance_to(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (Q, 2) from the boundary of a polygon (P, 2), (Q,) [m]."""
    along = np.roll(polygon, -1, axis=0) - polygon
    offset = points[:, None] - polygon
    fraction = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(offset - fraction[..., None] * along, axis=-1).min(axis=1)


def segments_cross(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """Return whether segments a-b and c-d, each (..., 2), cross in their interiors, (...) bool."""

    def side(p: np.ndarray, q: np.ndarray, r: np.ndarray) -> np.ndarray:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    return (side(a, b, c) * side(a, b, d) < 0.0) & (side(c, d, a) * side(c, d, b) < 0.0)


def corner_indices(polygon: np.ndarray) -> np.ndarray:
    """Return the vertices of a polygon (P, 2) at which it turns by more than `CORNER_ANGLE`, ascending."""
    forward = np.roll(polygon, -1, axis=0) - polygon
    backward = np.roll(forward, 1, axis=0)
    cross = backward[:, 0] * forward[:, 1] - backward[:, 1] * forward[:, 0]
    return np.flatnonzero(np.abs(np.arctan2(cross, (backward * forward).sum(1))) > CORNER_ANGLE)


def check_polygon(points: np.ndarray, name: str) -> np.ndarray:
    """Return a polygon as float64 (P, 2), counter-clockwise and without a repeated last point.

    Raises:
        ValueError: If it is not finite, has fewer than three points, repeats a point, crosses itself, or has no area.
    """
    polygon = np.asarray(points, dtype=np.float64)
    if polygon.ndim != 2 or polygon.shape[1] != 2 or len(polygon) < 3:
        raise ValueError(f"{name} must be a polygon (P >= 3, 2), got shape {polygon.shape}")
    if not np.isfinite(polygon).all():
        raise ValueError(f"{name} must be finite, got NaN or infinity")
    if np.array_equal(polygon[0], polygon[-1]):
        polygon = polygon[:-1]
    size = np.ptp(polygon, axis=0).max()
    area = signed_area(polygon)
    if not abs(area) > 1e-6 * size**2:
        raise ValueError(f"{name} must enclose an area, got {abs(area):.3g} m^2 in a box of {size:.3g} m")
    if np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1).min() <= 1e-9 * size:
        raise ValueError(f"{name} must not repeat a point")
    first, second = np.triu_indices(len(polygon), k=1)
    end = np.roll(polygon, -1, axis=0)
    crossing = segments_cross(polygon[first], end[first], polygon[second], end[second])
    if crossing.any():
        pair = int(np.flatnonzero(crossing)[0])
        raise ValueError(f"{name} must not intersect itself, edges {first[pair]} and {second[pair]} cross")
    return polygon if area > 0.0 else polygon[::-1].copy()


def check_holes(outline: np.ndarray, holes: list[np.ndarray]) -> None:
    """Raise ValueError unless all holes (P, 2) lie inside the outline (P, 2) and apart from each other."""
    for index, hole in enumerate(holes):
        if not contains(outline, hole).all() or _polygons_cross(outline, hole):
            raise ValueError(f"hole {index} must lie inside the outline")
        for other in range(index):
            if contains(holes[other], hole).any() or contains(hole, holes[other]).any() or _polygons_cross(holes[other], hole):
                raise ValueError(f"holes {other} and {index} must not overlap")


def _polygons_cross(a: np.ndarray, b: np.ndarray) -> bool:
    a_end, b_end = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    return bool(segments_cross(a[:, None], a_end[:, None], b[None], b_end[None]).any())
