"""Triangulated surfaces in space: which triangles meet where, and what lies beside each other once it is unfolded."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

# A node this far out of a triangle's plane, relative to the size of the surface, lies in it.
IN_PLANE = 1e-12


@dataclass(frozen=True)
class Surface:
    """Triangles in space, at most two at each edge."""

    points: np.ndarray
    """(N, 3) float64 [m]."""
    faces: np.ndarray
    """Triangles, (F, 3) int64."""
    frames: np.ndarray
    """Two orthogonal unit vectors in the plane of each triangle, (F, 2, 3)."""

    @cached_property
    def _mesh(self) -> trimesh.Trimesh:
        return trimesh.Trimesh(self.points, self.faces, process=False)

    @property
    def areas(self) -> np.ndarray:
        """Areas of the triangles, (F,) [m^2]."""
        return self._mesh.area_faces

    @property
    def edges(self) -> np.ndarray:
        """Edges of the triangles, (E, 2) int64."""
        return self._mesh.edges_unique

    @cached_property
    def faces_of_edges(self) -> np.ndarray:
        """The one or two triangles at each edge, (E, 2), -1 for none."""
        members = np.full((len(self.edges), 2), -1, dtype=np.int64)
        for face, edges in enumerate(self._mesh.faces_unique_edges):
            for edge in edges:
                members[edge, int(members[edge, 0] >= 0)] = face
        return members

    @property
    def pair_faces(self) -> np.ndarray:
        """The two triangles of each hinge, (H, 2)."""
        return self._mesh.face_adjacency

    @cached_property
    def pair_nodes(self) -> np.ndarray:
        """The two nodes of the edge of each hinge, then the one opposite it in each of its triangles, (H, 4)."""
        return np.column_stack([self._mesh.face_adjacency_edges, self._mesh.face_adjacency_unshared])

    @cached_property
    def loops(self) -> list[np.ndarray]:
        """Nodes of each boundary in order, each (L,) int64, the one with the most nodes first."""
        rim = self.edges[self.faces_of_edges[:, 1] < 0]
        beside: dict[int, list[int]] = {}
        for a, b in rim.tolist():
            beside.setdefault(a, []).append(b)
            beside.setdefault(b, []).append(a)
        loops = []
        for start in beside:
            loop, node = [], start
            while beside[node]:
                following = beside[node].pop(0)
                beside[following].remove(node)
                loop.append(node)
                node = following
            if loop:
                loops.append(np.array(loop, dtype=np.int64))
        return sorted(loops, key=len, reverse=True)

    def unfold(self, hinges: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Turn hinges flat about their edges.

        Args:
            hinges: Rows of `pair_nodes`, (H, 4).
            faces: Triangle of each hinge into whose plane the other is turned, (H,).

        Returns:
            Where their nodes then lie in the frame of that triangle, (H, 4, 2) [m].
        """
        corners = self.points[hinges]
        frames = self.frames[faces]
        flat = np.einsum("hkd,hcd->hkc", corners, frames)
        outside = np.einsum("hkd,hd->hk", corners - corners[:, :1], np.cross(frames[:, 0], frames[:, 1]))
        along = flat[:, 1] - flat[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        across = np.column_stack([-along[:, 1], along[:, 0]])
        second = np.flatnonzero(np.abs(outside[:, 2]) > np.abs(outside[:, 3]))  # hinges that lie in their second triangle
        sides = np.sign(((flat[:, 2] - flat[:, 0]) * across).sum(axis=1))
        sides[second] = -np.sign(((flat[second, 3] - flat[second, 0]) * across[second]).sum(axis=1))
        is_out = np.abs(outside) > IN_PLANE * np.ptp(self.points, axis=0).max()
        for apex, side in ((2, sides), (3, -sides)):
            offset = flat[:, apex] - flat[:, 0]
            height = np.hypot((offset * across).sum(axis=1), outside[:, apex])
            turned = flat[:, 0] + (offset * along).sum(axis=1)[:, None] * along + (side * height)[:, None] * across
            flat[:, apex] = np.where(is_out[:, apex, None], turned, flat[:, apex])
        return flat

    def fold_sines(self) -> np.ndarray:
        """Return sin(theta / 2) of the angle theta by which each hinge is folded, positive towards its normals, (H,)."""
        x = self.points[self.pair_nodes]
        along = x[:, 1] - x[:, 0]
        first, second = np.cross(along, x[:, 2] - x[:, 0]), np.cross(x[:, 3] - x[:, 0], along)
        first = first / np.linalg.norm(first, axis=1, keepdims=True)
        second = second / np.linalg.norm(second, axis=1, keepdims=True)
        sign = np.where((np.cross(second, first) * along).sum(axis=1) < 0.0, -1.0, 1.0)
        return 0.5 * sign * np.linalg.norm(first - second, axis=1)


def flat_surface(points: np.ndarray, faces: np.ndarray) -> Surface:
    """Return a surface (N, 2) [m], (F, 3) in the plane z = 0, all of whose triangles have the axes x and y as their frame."""
    frames = np.broadcast_to(np.eye(3)[:2], (len(faces), 2, 3))
    return Surface(np.column_stack([points, np.zeros(len(points))]), faces, frames)


def curved_surface(points: np.ndarray, faces: np.ndarray) -> Surface:
    """Return a surface (N, 3) [m], (F, 3) each of whose triangles has its first edge as the first axis of its frame."""
    first, second = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    first = first / np.linalg.norm(first, axis=1, keepdims=True)
    second = second - (second * first).sum(axis=1, keepdims=True) * first
    frames = np.stack([first, second / np.linalg.norm(second, axis=1, keepdims=True)], axis=1)
    return Surface(points, faces, frames)
