"""Triangle meshes as they come from code or files: sewn where vertices meet, refused where they cannot be a cloth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

MERGE_DISTANCE = 1e-6
"""Vertices nearer to each other than this share of the mesh's size are one node."""
SMALLEST_SHAPE = 1e-4
"""Triangles with less than this share of their longest edge's square as area have no shape worth the name."""


def sew(vertices: Any, faces: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Merge vertices at the same place and check that the triangles form one surface.

    Args:
        vertices: (V, 3) [m].
        faces: Vertex indices, (F, 3).

    Returns:
        points: Nodes in the order of their first vertices, (N, 3) float64 [m].
        faces: Node indices, (F, 3) int64.
        node_of_vertex: (V,) int64.

    Raises:
        ValueError: If a shape or type does not fit, a vertex is not finite or belongs to no face, an index is out of range, a
            face has no area or occurs twice, an edge belongs to more than two faces, or the mesh is in pieces. Names which.
    """
    points, triangles = _check_arrays(vertices, faces)
    unused = np.setdiff1d(np.arange(len(points)), triangles)
    if len(unused):
        raise ValueError(f"every vertex must belong to a face, to none belongs {_named('vertex', 'vertices', unused)}")
    points, node_of_vertex = _merge(points)
    nodes = node_of_vertex[triangles]
    _check_areas(points, nodes)
    _check_edges(nodes, triangles)
    ends = nodes[:, [0, 1, 1, 2]].reshape(-1, 2).T
    graph = coo_matrix((np.ones(ends.shape[1]), tuple(ends)), shape=(len(points), len(points)))
    num_pieces, piece = connected_components(graph, directed=False)
    if num_pieces > 1:
        apart = np.flatnonzero(piece[node_of_vertex] != piece[0])
        raise ValueError(
            f"a cloth must be of one piece, got {num_pieces}; vertex {apart[0]} is not connected to vertex 0. Pieces are sewn "
            "together where their vertices are at the same place"
        )
    return points, nodes, node_of_vertex


def _check_arrays(vertices: Any, faces: Any) -> tuple[np.ndarray, np.ndarray]:
    points, triangles = np.asarray(vertices), np.asarray(faces)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0 or points.dtype.kind not in "iuf":
        raise ValueError(f"vertices must be numbers (V >= 1, 3), got {points.dtype} of shape {points.shape}")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        raise ValueError(f"vertices must be finite, vertex {bad[0]} is {points[bad[0]].tolist()}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0 or triangles.dtype.kind not in "iu":
        raise ValueError(f"faces must be whole numbers (F >= 1, 3), got {triangles.dtype} of shape {triangles.shape}")
    bad = np.flatnonzero(((triangles < 0) | (triangles >= len(points))).any(axis=1))
    if len(bad):
        raise ValueError(f"faces must index vertices 0 to {len(points) - 1}, face {bad[0]} is {triangles[bad[0]].tolist()}")
    return points.astype(np.float64), triangles.astype(np.int64)


def _merge(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the points without those that repeat an earlier one, and the place of each in that list."""
    pairs = cKDTree(points).query_pairs(MERGE_DISTANCE * np.ptp(points, axis=0).max(), output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points), len(points)))
    _, labels = connected_components(graph, directed=False)
    _, first, place = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty_like(first)
    rank[np.argsort(first)] = np.arange(len(first))
    return points[np.sort(first)], rank[place].astype(np.int64)


def _check_areas(points: np.ndarray, faces: np.ndarray) -> None:
    corners = points[faces]
    sides = np.roll(corners, -1, axis=1) - corners
    areas = 0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    flat = np.flatnonzero(areas <= SMALLEST_SHAPE * (sides**2).sum(axis=2).max(axis=1))
    if len(flat):
        raise ValueError(f"faces must have an area, none has {_named('face', 'faces', flat)}")


def _check_edges(nodes: np.ndarray, vertices: np.ndarray) -> None:
    """Raise ValueError if two faces have the same nodes, or an edge belongs to more than two faces."""
    _, first, counts = np.unique(np.sort(nodes, axis=1), axis=0, return_index=True, return_counts=True)
    if (counts > 1).any():
        index = first[counts > 1].min()
        same = np.flatnonzero((np.sort(nodes, axis=1) == np.sort(nodes[index])).all(axis=1))
        raise ValueError(f"faces must differ, {_named('face', 'faces', same)} have the same corners {vertices[index].tolist()}")
    sides = np.sort(nodes[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, inverse, counts = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    if counts.max() > 2:
        side = int(np.flatnonzero(counts[inverse.ravel()] > 2)[0])
        around = np.flatnonzero(inverse.ravel() == inverse.ravel()[side]) // 3
        ends = vertices[side // 3][[side % 3, (side + 1) % 3]]
        raise ValueError(
            f"at most two faces may meet at an edge, {_named('face', 'faces', around)} meet at the edge of vertices "
            f"{ends[0]} and {ends[1]}"
        )


def _named(singular: str, plural: str, indices: Sequence[int]) -> str:
    """Return a few indices and how many more there are: "faces 3, 7, 12 and 40 more"."""
    shown = ", ".join(str(index) for index in indices[:5])
    more = f" and {len(indices) - 5} more" if len(indices) > 5 else ""
    return f"{singular if len(indices) == 1 else plural} {shown}{more}"
