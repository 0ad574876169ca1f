"""Rigid bodies as triangles whose vertices are linear in the size of the body, so that a kernel can place them in every world."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np
import trimesh

from maniskill_grpd.physics import Collider
from maniskill_grpd.physics.colliders import ColliderKind

SECTIONS = 48
"""Sides of what is round."""
JAW_RADIUS = 0.016
"""Radius of the grippers' balls [m]."""
JAW_OPENING = 0.014
"""Distance of the two halves of the ball of an open gripper [m]."""
TABLE_HALF_SIZE = 0.8
"""Half the side of the table [m]."""


@dataclass(frozen=True)
class Body:
    """A triangle mesh in the frame of its body: vertex v is at sum_k size_k basis[v, k]."""

    basis: np.ndarray
    """(V, 3, 3): vertex, component of the size, coordinate."""
    faces: np.ndarray
    """Triangles, counter-clockwise as seen from outside, (F, 3)."""

    def vertices(self, size: np.ndarray) -> np.ndarray:
        """Return the vertices of a body of some size (3,), (V, 3) [m]."""
        return np.einsum("k,vkc->vc", np.asarray(size, dtype=np.float64), self.basis)


def collider_body(collider: Collider) -> Body:
    """Return what an obstacle looks like; its size means what that of a `Collider` means.

    Raises:
        ValueError: If it is a plane, which has no end.
    """
    if collider.kind not in (*_UNIT, *_SHAPED):
        ended = [kind.name.lower() for kind in (*_UNIT, *_SHAPED)]
        raise ValueError(f"a {collider.kind.name.lower()} has no end; bodies are {ended}")
    if collider.kind in _SHAPED:
        return _SHAPED[collider.kind](collider)
    return _unit_body(collider.kind)


def mesh_body(vertices: np.ndarray, faces: np.ndarray) -> Body:
    """Return a body of vertices (V, 3) [m] and triangles (F, 3), for the size (1, ., .)."""
    return _scaled(vertices, faces)


def table_body() -> Body:
    """Return the top of the table in the plane z = 0, for the size (1, ., .)."""
    corners = TABLE_HALF_SIZE * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    return _scaled(corners, np.array([[0, 1, 2], [0, 2, 3]]))


def gripper_body(*, is_closed: bool, subdivisions: int) -> Body:
    """Return the ball of a closed gripper, or the two halves of an open one, for the size (1, ., .)."""
    ball = trimesh.creation.icosphere(subdivisions=subdivisions, radius=JAW_RADIUS)
    vertices, faces = ball.vertices.view(np.ndarray), ball.faces.view(np.ndarray)
    if is_closed:
        return _scaled(vertices, faces)
    # Pressed flat on one side, the ball is half a ball.
    halves = [
        side * np.maximum(side * vertices * (1.0, 0.0, 0.0), 0.0)
        + vertices * (0.0, 1.0, 1.0)
        + [side * JAW_OPENING / 2.0, 0.0, 0.0]
        for side in (1.0, -1.0)
    ]
    return _scaled(np.concatenate(halves), np.concatenate([faces, faces + len(vertices)]))


def _scaled(vertices: np.ndarray, faces: np.ndarray) -> Body:
    """Return a body whose first size is a scale."""
    return _long(vertices, np.zeros(len(vertices)), faces)


def _long(across: np.ndarray, ends: np.ndarray, faces: np.ndarray) -> Body:
    """Return a body of points (V, 3) for a unit scale, those of `ends` +-1 (V,) moved along z by half the length."""
    basis = np.zeros((len(across), 3, 3))
    basis[:, 0], basis[:, 1, 2] = across, ends
    return Body(basis, np.asarray(faces))


def _box() -> Body:
    mesh = trimesh.creation.box(extents=[2.0] * 3)
    return Body(mesh.vertices[:, :, None] * np.eye(3), np.asarray(mesh.faces))


def _capsule() -> Body:
    mesh = trimesh.creation.capsule(radius=1.0, height=2.0, count=[SECTIONS, SECTIONS // 2], transform=None)
    vertices = mesh.vertices.view(np.ndarray)
    ends = np.sign(vertices[:, 2])
    return _long(vertices - ends[:, None] * (0.0, 0.0, 1.0), ends, mesh.faces)


def _cylinder() -> Body:
    mesh = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=SECTIONS)
    return _long(mesh.vertices * (1.0, 1.0, 0.0), np.sign(mesh.vertices[:, 2]), mesh.faces)


def _prism(collider: Collider) -> Body:
    """Return a convex polygon (P, 2), pulled up and down along z."""
    ends = [np.pad(collider.polygon, ((0, 0), (0, 1)), constant_values=z) for z in (-1.0, 1.0)]
    mesh = trimesh.convex.convex_hull(np.concatenate(ends))
    return _long(mesh.vertices * (1.0, 1.0, 0.0), np.sign(mesh.vertices[:, 2]), mesh.faces)


def _sphere() -> Body:
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return _scaled(mesh.vertices, mesh.faces)


@cache
def _unit_body(kind: ColliderKind) -> Body:
    return _UNIT[kind]()


_UNIT: dict[ColliderKind, Callable[[], Body]] = {
    ColliderKind.SPHERE: _sphere,
    ColliderKind.CAPSULE: _capsule,
    ColliderKind.BOX: _box,
    ColliderKind.CYLINDER: _cylinder,
}
"""Bodies that differ in nothing but their size."""
_SHAPED: dict[ColliderKind, Callable[[Collider], Body]] = {
    ColliderKind.PRISM: _prism,
    ColliderKind.MESH: lambda collider: _scaled(collider.vertices, collider.faces),
}
