"""Triangle meshes of polygons with holes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial import Delaunay

from maniskill_grpd.physics.mesh.curves import resample_polyline
from maniskill_grpd.physics.mesh.outlines import contains, corner_indices, distance_to, signed_area

MAX_DIVISIONS = 400
SMOOTHING_SWEEPS = 12


@dataclass(frozen=True)
class PlanarMesh:
    """A triangle mesh in the plane."""

    points: np.ndarray
    """(N, 2) float64 [m]."""
    faces: np.ndarray
    """Triangles, counter-clockwise, (F, 3) int64."""
    loops: list[np.ndarray]
    """Nodes of the outline and of each hole in order, each (L,) int64."""
    corners: np.ndarray
    """Nodes at the corners of the outline in its order (extreme points if it has none), int64."""


def triangulate(outline: np.ndarray, holes: list[np.ndarray], num_nodes: int) -> PlanarMesh:
    """Mesh a polygon with about `num_nodes` nodes.

    Rectilinear outlines get a square grid, all others a triangular lattice that is smoothed towards the boundary. Boundaries are
    sampled at the spacing of the lattice; a Delaunay triangulation of all points is clipped to the polygon.

    Args:
        outline: Counter-clockwise polygon, (P, 2) [m].
        holes: Polygons inside, each (P, 2) [m].
        num_nodes: Wanted number of nodes; the nearest spacing that fits a whole number of times into an edge is taken.

    Raises:
        ValueError: If the polygon has details that so few nodes cannot mesh.
    """
    best: tuple[np.ndarray, list[np.ndarray], float] | None = None
    for divisions in range(1, MAX_DIVISIONS):
        points, loops, spacing = _place_points(outline, holes, divisions)
        if best is None or abs(len(points) - num_nodes) < abs(len(best[0]) - num_nodes):
            best = points, loops, spacing
        if len(points) > num_nodes:
            break
    points, loops, spacing = best
    if not _is_rectilinear(outline):
        points = _smooth(points, loops, outline, holes)
    faces = _clipped_delaunay(points, [points[loop] for loop in loops])
    if _is_rectilinear(outline):
        faces = _alternate_diagonals(points, faces, spacing)
    covered = sum(abs(signed_area(points[face])) for face in faces)
    expected = signed_area(points[loops[0]]) - sum(abs(signed_area(points[loop])) for loop in loops[1:])
    if len(np.unique(faces)) != len(points) or not abs(covered - expected) < 1e-6 * expected:
        raise ValueError(
            f"num_nodes={num_nodes} is too coarse for this outline: a mesh with spacing {spacing:.3g} m covers {covered:.4g} m^2 "
            f"of {expected:.4g} m^2"
        )
    return _in_reading_order(points, faces, loops, outline)


def _place_points(outline: np.ndarray, holes: list[np.ndarray], divisions: int) -> tuple[np.ndarray, list[np.ndarray], float]:
    """Return points (N, 2) on boundaries and inside, the nodes of each boundary, and the spacing [m]."""
    rectilinear = _is_rectilinear(outline)
    corner = corner_indices(outline)
    if rectilinear:
        size = np.ptp(outline, axis=0)
        counts = np.maximum(1, np.round(divisions * size / size.max()))
        step = size / counts
        spacing = float(step.max())
    else:
        length = np.linalg.norm(outline[1] - outline[0]) if _is_equilateral(outline, corner) else _perimeter(outline) / 6.0
        spacing = float(length / divisions)
    steps = step if rectilinear else np.full(2, spacing)
    boundaries = [_sample_boundary(outline, steps), *(_sample_boundary(hole, np.full(2, spacing)) for hole in holes)]
    if rectilinear:
        low, high = outline.min(axis=0), outline.max(axis=0)
        axes = [np.linspace(low[k], high[k], int(counts[k]) + 1) for k in range(2)]
        lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)
    else:
        lattice = _triangular_lattice(outline, spacing, outline[corner[0]] if len(corner) else outline.mean(axis=0))
    inside = contains(outline, lattice) & (distance_to(outline, lattice) > 0.5 * spacing)
    for hole in holes:
        inside &= ~contains(hole, lattice) & (distance_to(hole, lattice) > 0.55 * spacing)
    sizes = np.cumsum([0] + [len(boundary) for boundary in boundaries])
    loops = [np.arange(start, end) for start, end in zip(sizes[:-1], sizes[1:], strict=True)]
    return np.concatenate([*boundaries, lattice[inside]]), loops, spacing


def _is_rectilinear(outline: np.ndarray) -> bool:
    sides = np.abs(np.roll(outline, -1, axis=0) - outline)
    return bool((sides.min(axis=1) <= 1e-9 * sides.max()).all())


def _is_equilateral(outline: np.ndarray, corners: np.ndarray) -> bool:
    """Return whether all vertices of a polygon are corners and all its sides are equally long."""
    sides = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1)
    return 2 < len(corners) == len(outline) and np.ptp(sides) < 1e-6 * sides.max()


def _perimeter(polygon: np.ndarray) -> float:
    return float(np.linalg.norm(np.roll(polygon, -1, axis=0) - polygon, axis=1).sum())


def _sample_boundary(polygon: np.ndarray, spacing: np.ndarray) -> np.ndarray:
    """Place points along a polygon (P, 2), with one on each corner, at about `spacing` for sides mainly along x and along y."""
    corners = corner_indices(polygon)
    if len(corners) == 0:
        closed = np.concatenate([polygon, polygon[:1]])
        return resample_polyline(closed, max(6, round(_perimeter(polygon) / spacing.max())) + 1)[:-1]
    parts = []
    for start, end in zip(corners, np.roll(corners, -1), strict=True):
        steps = (end - start) % len(polygon) or len(polygon)
        side = polygon[(start + np.arange(steps + 1)) % len(polygon)]
        length = np.linalg.norm(np.diff(side, axis=0), axis=1).sum()
        step = spacing[np.abs(side[-1] - side[0]).argmax()]
        parts.append(resample_polyline(side, max(1, round(length / step)) + 1)[:-1])
    return np.concatenate(parts)


def _triangular_lattice(outline: np.ndarray, spacing: float, anchor: np.ndarray) -> np.ndarray:
    """Return a lattice of equilateral triangles over the box of the outline, through `anchor`, one direction along x."""
    reach = int(np.ceil(2.0 * np.ptp(outline, axis=0).max() / spacing)) + 1
    i, j = (index.ravel() for index in np.meshgrid(*2 * [np.arange(-reach, reach + 1)], indexing="ij"))
    lattice = anchor + spacing * np.column_stack([i + 0.5 * (j % 2), j * np.sqrt(0.75)])
    in_box = ((lattice >= outline.min(axis=0)) & (lattice <= outline.max(axis=0))).all(axis=1)
    return lattice[in_box]


def _smooth(points: np.ndarray, loops: list[np.ndarray], outline: np.ndarray, holes: list[np.ndarray]) -> np.ndarray:
    """Move interior points to the mean of their neighbours a few times; boundary points stay."""
    points = points.copy()
    num_boundary = sum(len(loop) for loop in loops)
    for _ in range(SMOOTHING_SWEEPS):
        faces = _clipped_delaunay(points, [points[loop] for loop in loops])
        sums, counts = np.zeros_like(points), np.zeros(len(points))
        for a, b in ((0, 1), (1, 2), (2, 0), (1, 0), (2, 1), (0, 2)):
            np.add.at(sums, faces[:, a], points[faces[:, b]])
            np.add.at(counts, faces[:, a], 1.0)
        moved = sums[num_boundary:] / np.maximum(counts[num_boundary:, None], 1.0)
        valid = (counts[num_boundary:] > 0) & contains(outline, moved)
        for hole in holes:
            valid &= ~contains(hole, moved)
        points[num_boundary:][valid] = moved[valid]
    return points


def _clipped_delaunay(points: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
    """Triangulate points and keep the counter-clockwise triangles inside the first loop and outside the others, (F, 3)."""
    # Four points of a square lie on a circle: a shear far above rounding and far below the spacing lets all diagonals lean alike.
    sheared = points + 1e-7 * points[:, ::-1] * np.array([1.0, 0.0])
    faces = Delaunay(sheared).simplices.astype(np.int64)
    a, b, c = points[faces[:, 0]], points[faces[:, 1]], points[faces[:, 2]]
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    longest = np.max([np.linalg.norm(b - a, axis=1), np.linalg.norm(c - b, axis=1), np.linalg.norm(a - c, axis=1)], axis=0)
    faces = np.where(area[:, None] < 0.0, faces[:, ::-1], faces)
    centroids = (a + b + c) / 3.0
    keep = (np.abs(area) > 1e-3 * longest**2) & contains(loops[0], centroids)
    for hole in loops[1:]:
        keep &= ~contains(hole, centroids)
    return faces[keep]


def _alternate_diagonals(points: np.ndarray, faces: np.ndarray, spacing: float) -> np.ndarray:
    """Let the diagonals of a square grid meet at every other node.

    Then the two triangles at each side of a square are mirror images, so that no direction of bending is preferred.
    """
    surface = trimesh.Trimesh(np.column_stack([points, np.zeros(len(points))]), faces, process=False)
    diagonal, across = surface.face_adjacency_edges, surface.face_adjacency_unshared
    lengths = [np.linalg.norm(points[pair[:, 1]] - points[pair[:, 0]], axis=1) for pair in (diagonal, across)]
    is_square = np.abs(lengths[0] - lengths[1]) < 1e-6 * spacing
    size = np.ptp(points, axis=0)
    parity = np.round((points - points.min(axis=0)) / size * np.round(size / spacing)).sum(axis=1) % 2
    flipped = np.flatnonzero(is_square & (parity[diagonal[:, 0]] == 1))
    faces = faces.copy()
    for (first, second), (a, b), (c, d) in zip(surface.face_adjacency[flipped], diagonal[flipped], across[flipped], strict=True):
        for face, corners in ((first, (c, d, a)), (second, (d, c, b))):
            faces[face] = corners if signed_area(points[list(corners)]) > 0.0 else corners[::-1]
    return faces


def _in_reading_order(points: np.ndarray, faces: np.ndarray, loops: list[np.ndarray], outline: np.ndarray) -> PlanarMesh:
    """Number nodes by x, then y: neighbours in the mesh are close in memory, and numbering does not depend on Qhull."""
    scale = 1e6 / np.ptp(points, axis=0).max()
    order = np.lexsort((np.round(points[:, 1] * scale), np.round(points[:, 0] * scale)))
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[faces]
    first = faces.argmin(axis=1)[:, None]
    faces = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    faces = faces[np.lexsort(faces.T[::-1])]
    points = points[order]
    loops = [rank[loop] for loop in loops]
    at_corners = outline[corner_indices(outline)]
    if len(at_corners) == 0:
        rim = points[loops[0]]
        at_corners = rim[[rim[:, 0].argmax(), rim[:, 1].argmax(), rim[:, 0].argmin(), rim[:, 1].argmin()]]
    corners = np.linalg.norm(points[None] - at_corners[:, None], axis=-1).argmin(axis=1)
    return PlanarMesh(points, faces, loops, corners)
