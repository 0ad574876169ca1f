"""Meshes that lie flat, in the coordinates of their own plane."""

from __future__ import annotations

import numpy as np

from maniskill_grpd.physics.mesh.outlines import check_polygon, corner_indices, signed_area
from maniskill_grpd.physics.mesh.surface import Surface
from maniskill_grpd.physics.mesh.triangulation import PlanarMesh

# Nodes of a flat mesh are this near to its plane, relative to its size; files often hold six digits.
FLATNESS = 1e-5


def plane_axes(points: np.ndarray) -> np.ndarray | None:
    """Return two orthogonal unit vectors (2, 3) in the plane of points (N, 3), or None if they lie in none.

    A plane of constant z has the axes x and y.
    """
    centered = points - points.mean(axis=0)
    size = np.ptp(points, axis=0).max()
    if np.abs(centered[:, 2]).max() <= FLATNESS * size:
        return np.eye(3)[:2]
    axes = np.linalg.svd(centered, full_matrices=False)[2]
    return axes[:2] if np.abs(centered @ axes[2]).max() <= FLATNESS * size else None


def flatten(surface: Surface) -> PlanarMesh | None:
    """Return a flat surface in the coordinates of its plane, with its faces counter-clockwise; None if it is not flat.

    A sheet that is folded flat, or layers that lie on each other, are not flat in this sense: their triangles overlap.
    """
    axes = plane_axes(surface.points)
    if axes is None or not surface.loops:
        return None
    points = surface.points @ axes.T
    loops = sorted(surface.loops, key=lambda loop: -abs(signed_area(points[loop])))
    loops[0] = loops[0] if signed_area(points[loops[0]]) > 0.0 else loops[0][::-1]
    areas = [abs(signed_area(points[loop])) for loop in loops]
    enclosed = areas[0] - sum(areas[1:])
    if abs(surface.areas.sum() - enclosed) > 1e-6 * enclosed:
        return None
    outline = points[loops[0]]
    try:
        check_polygon(outline, "the outline")
    except ValueError:
        return None
    a, b, c = np.moveaxis(points[surface.faces], 1, 0)
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    faces = np.where(clockwise[:, None], surface.faces[:, ::-1], surface.faces)
    corners = corner_indices(outline)
    if len(corners) == 0:
        corners = np.array([outline[:, 0].argmax(), outline[:, 1].argmax(), outline[:, 0].argmin(), outline[:, 1].argmin()])
    return PlanarMesh(points, faces, loops, loops[0][corners])
