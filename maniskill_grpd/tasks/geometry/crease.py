"""Creases: straight lines across a flat sheet, along which it is folded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import ConvexHull

SMALLEST_TURN = 1e-3
"""Smaller turns of a hull are rounding errors of points on a straight side [rad]."""
BISECTIONS = 30
"""Halvings of an interval as wide as the sheet: more than float32 has digits."""


def hull_corners(points: np.ndarray) -> np.ndarray:
    """Return which of the points (n, 2) are corners of their convex hull, counter-clockwise, (S,) int64."""
    vertices = ConvexHull(points).vertices
    forward = np.roll(points[vertices], -1, axis=0) - points[vertices]
    backward = np.roll(forward, 1, axis=0)
    turn = np.arctan2(backward[:, 0] * forward[:, 1] - backward[:, 1] * forward[:, 0], (backward * forward).sum(1))
    return vertices[turn > SMALLEST_TURN].astype(np.int64)


def is_convex(outline: np.ndarray) -> bool:
    """Return whether a counter-clockwise polygon (P, 2) turns right nowhere."""
    forward = np.roll(outline, -1, axis=0) - outline
    backward = np.roll(forward, 1, axis=0)
    turn = np.arctan2(backward[:, 0] * forward[:, 1] - backward[:, 1] * forward[:, 0], (backward * forward).sum(1))
    return bool((turn > -SMALLEST_TURN).all())


def side_directions(outline: np.ndarray) -> np.ndarray:
    """Return the outward normals of the sides of a counter-clockwise polygon (P, 2), unit vectors (S, 2).

    Sides that lie within its convex hull, and those of the hull that bridge a notch, are left out: what is beyond a crease along
    one of these is not carried by its two ends. Where all sides of the hull bridge notches, as in a star, these are the sides:
    each of the two points beyond a crease is carried by its own tip.
    """
    corners = hull_corners(outline)
    normals = _hull_normals(outline[corners])
    is_side = np.array([_is_straight(outline, first, last) for first, last in zip(corners, np.roll(corners, -1), strict=True)])
    return normals[is_side] if is_side.any() else normals


def _is_straight(outline: np.ndarray, first: int, last: int) -> bool:
    """Return whether the outline runs straight from one of its vertices to another."""
    steps = (last - first) % len(outline)
    between = outline[(first + np.arange(1, steps)) % len(outline)] - outline[first]
    along = outline[last] - outline[first]
    return bool((np.abs(between[:, 0] * along[1] - between[:, 1] * along[0]) <= SMALLEST_TURN * (along @ along)).all())


def cut_open(outline: np.ndarray, holes: Sequence[np.ndarray]) -> np.ndarray:
    """Return one polygon around a cloth with holes, (R, 2): slits of no width join them to the outline.

    Integrals around it, as in `area_beyond`, leave out the holes, since each slit is passed in both directions.

    Args:
        outline: Counter-clockwise polygon, (P, 2) [m].
        holes: Counter-clockwise polygons inside, each (H, 2) [m].
    """
    region = outline
    for hole in holes:
        around = np.concatenate([hole[:1], hole[::-1], region[:1]])
        region = np.concatenate([region, region[:1], around])[:-1]
    return region


def corner_directions(outline: np.ndarray) -> np.ndarray:
    """Return the outward bisectors of the corners of the convex hull of a polygon (P, 2), unit vectors (S, 2)."""
    normals = _hull_normals(outline[hull_corners(outline)])
    bisectors = normals + np.roll(normals, -1, axis=0)
    return bisectors / np.linalg.norm(bisectors, axis=1, keepdims=True)


def _hull_normals(corners: np.ndarray) -> np.ndarray:
    along = np.roll(corners, -1, axis=0) - corners
    return np.column_stack([along[:, 1], -along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)


def signed_distances(points: torch.Tensor, normal: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    """Return how far points (b, n, D) are beyond the creases normal . x = offset, (b, n) [m].

    Args:
        points: (b, n, D) [m].
        normal: Unit normals of the creases, towards the part that is to move, (b, D).
        offset: (b,) [m].
    """
    return (points * normal[:, None]).sum(-1) - offset[:, None]


def mirror(points: torch.Tensor, normal: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    """Return the mirror images of points (b, n, D) [m] across creases, see `signed_distances`."""
    return points - 2.0 * signed_distances(points, normal, offset)[..., None] * normal[:, None]


def area_beyond(outlines: torch.Tensor, normal: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    """Return the area of the parts of polygons beyond creases.

    With u along the normal and v along the crease, the area is the integral of max(u - offset, 0) dv around the outline; each of
    its edges contributes the mean of that function, which is linear with a kink.

    Args:
        outlines: Counter-clockwise polygons, not necessarily convex, (b, P, 2) [m]; points may be repeated.
        normal: Unit normals of the creases, (b, 2).
        offset: (b,) [m].

    Returns:
        (b,) [m^2].
    """
    start = signed_distances(outlines, normal, offset)
    end = start.roll(-1, dims=1)
    tangent = torch.stack([-normal[:, 1], normal[:, 0]], dim=-1)
    along = signed_distances(outlines, tangent, torch.zeros_like(offset))
    # For edges on one side the mean of the clamped ends; for the others the triangle beyond the crease.
    above, below = torch.maximum(start, end), torch.minimum(start, end)
    crossing = above.square() / (2.0 * (above - below).clamp(min=1e-12))
    mean = torch.where(below >= 0.0, 0.5 * (above + below), torch.where(above > 0.0, crossing, 0.0))
    return (mean * (along.roll(-1, dims=1) - along)).sum(dim=1)


def offset_of_share(outlines: torch.Tensor, normal: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
    """Return where creases must lie for the parts beyond them to have given shares of the area.

    Args:
        outlines: Counter-clockwise polygons, (b, P, 2) [m].
        normal: Unit normals of the creases, (b, 2).
        share: In (0, 1), (b,).

    Returns:
        Offsets of the creases, (b,) [m].
    """
    along = (outlines * normal[:, None]).sum(-1)
    low, high = along.amin(dim=1), along.amax(dim=1)
    wanted = share * area_beyond(outlines, normal, low)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        is_too_large = area_beyond(outlines, normal, middle) > wanted
        low, high = torch.where(is_too_large, middle, low), torch.where(is_too_large, high, middle)
    return 0.5 * (low + high)


def crease_ends(outlines: torch.Tensor, normal: torch.Tensor, offset: torch.Tensor) -> torch.Tensor:
    """Return the outermost points in which creases cross the outlines.

    Args:
        outlines: Polygons that the creases cross, (b, P, 2) [m].
        normal: Unit normals of the creases, (b, 2).
        offset: (b,) [m].

    Returns:
        (b, 2, 2) [m], the first on the right when one looks along the normal.
    """
    start = signed_distances(outlines, normal, offset)
    end = start.roll(-1, dims=1)
    tangent = torch.stack([-normal[:, 1], normal[:, 0]], dim=-1)
    along = (outlines * tangent[:, None]).sum(-1)
    fraction = (start / (start - end)).nan_to_num(0.0, 0.0, 0.0)
    at = along + fraction * (along.roll(-1, dims=1) - along)
    crosses = (start > 0.0) != (end > 0.0)
    extent = torch.stack([at.masked_fill(~crosses, torch.inf).amin(1), at.masked_fill(~crosses, -torch.inf).amax(1)], dim=1)
    return offset[:, None, None] * normal[:, None] + extent[..., None] * tangent[:, None]
