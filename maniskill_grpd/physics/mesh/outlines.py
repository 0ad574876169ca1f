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


def centroid(polygon: np.ndarray) -> np.ndarray:
    """Return the centre of mass (2,) of the area of a polygon (P, 2) [m]."""
    x, y = (polygon - polygon[0]).T
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    return polygon[0] + np.array([(x + np.roll(x, -1)) @ cross, (y + np.roll(y, -1)) @ cross]) / (3.0 * cross.sum())


def distance_to(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (Q, 2) from the boundary of a polygon (P, 2), (Q,) [m]."""
    return _distances_to_edges(polygon, points).min(axis=1)


def _distances_to_edges(polygon: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return the distance of points (Q, 2) from each edge of a polygon (P, 2), (Q, P) [m]."""
    along = np.roll(polygon, -1, axis=0) - polygon
    offset = points[:, None] - polygon
    fraction = np.clip((offset * along).sum(-1) / (along**2).sum(-1), 0.0, 1.0)
    return np.linalg.norm(offset - fraction[..., None] * along, axis=-1)


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
        ValueError: If it is not an array of at least three finite points, has no area, or touches or crosses itself.
    """
    polygon = as_points(points, name, "a polygon (P >= 3, 2)")
    if np.array_equal(polygon[0], polygon[-1]):
        polygon = polygon[:-1]
    if len(polygon) < 3:
        raise ValueError(f"{name} must be a polygon (P >= 3, 2), got {len(polygon)} points")
    size = np.ptp(polygon, axis=0).max()
    area = signed_area(polygon)
    if not abs(area) > 1e-6 * size**2:
        raise ValueError(f"{name} must enclose an area, got {abs(area):.3g} m^2 in a box of {size:.3g} m")
    _check_simple(polygon, name, 1e-9 * size)
    return polygon if area > 0.0 else polygon[::-1].copy()


def as_points(points: np.ndarray, name: str, wanted: str) -> np.ndarray:
    """Return points of the plane as float64 (P, 2).

    Args:
        points: What was given.
        name: What it is, for messages.
        wanted: What it has to be, for messages.

    Raises:
        ValueError: If it is not an array of numbers of that shape, or not finite.
    """
    try:
        array = np.asarray(points)
    except ValueError:
        raise ValueError(f"{name} must be {wanted}, got rows of different lengths") from None
    if array.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be {wanted} of numbers, got {points!r:.100}")
    if array.ndim != 2 or array.shape[1] != 2 or len(array) == 0:
        raise ValueError(f"{name} must be {wanted}, got an array of shape {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite, got {array[~np.isfinite(array).all(axis=1)][0]} in it")
    return array.astype(np.float64)


def _check_simple(polygon: np.ndarray, name: str, tolerance: float) -> None:
    """Raise ValueError if a vertex lies on another one or on an edge that it is no end of, or two edges cross."""
    num = len(polygon)
    first, second = np.triu_indices(num, k=1)
    repeated = np.linalg.norm(polygon[first] - polygon[second], axis=1) <= tolerance
    if repeated.any():
        pair = int(np.flatnonzero(repeated)[0])
        raise ValueError(f"{name} must not repeat a point, points {first[pair]} and {second[pair]} are the same")
    end = np.roll(polygon, -1, axis=0)
    crossing = segments_cross(polygon[first], end[first], polygon[second], end[second])
    if crossing.any():
        pair = int(np.flatnonzero(crossing)[0])
        raise ValueError(f"{name} must not intersect itself, edges {first[pair]} and {second[pair]} cross")
    distances = _distances_to_edges(polygon, polygon)
    own = np.arange(num)
    distances[own, own] = distances[own, own - 1] = np.inf
    if distances.min() <= tolerance:
        vertex, edge = np.unravel_index(int(distances.argmin()), distances.shape)
        raise ValueError(f"{name} must not touch itself, point {vertex} lies on edge {edge}")


def check_holes(outline: np.ndarray, holes: list[np.ndarray]) -> None:
    """Raise ValueError unless all holes (P, 2) lie inside the outline (P, 2) and apart from each other, without touching."""
    for index, hole in enumerate(holes):
        if not contains(outline, hole).all() or _polygons_meet(outline, hole):
            (left, low), (right, high) = hole.min(axis=0), hole.max(axis=0)
            box = f"[{left:.3g}, {right:.3g}] m x [{low:.3g}, {high:.3g}] m"
            raise ValueError(f"hole {index} must lie inside the outline, got one in the box {box} that leaves or touches it")
        for other in range(index):
            if contains(holes[other], hole).any() or contains(hole, holes[other]).any() or _polygons_meet(holes[other], hole):
                raise ValueError(f"holes {other} and {index} must not overlap or touch")


def _polygons_meet(a: np.ndarray, b: np.ndarray) -> bool:
    a_end, b_end = np.roll(a, -1, axis=0), np.roll(b, -1, axis=0)
    if segments_cross(a[:, None], a_end[:, None], b[None], b_end[None]).any():
        return True
    return bool(min(distance_to(a, b).min(), distance_to(b, a).min()) <= 1e-9 * np.ptp(a, axis=0).max())
