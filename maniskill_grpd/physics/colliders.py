"""Rigid obstacles, the same kinds in all worlds with a pose, a size and a switch in each."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from maniskill_grpd.physics.mesh.outlines import check_polygon

MAX_POLYGON_VERTICES = 16


class ColliderKind(IntEnum):
    """Shape of a collider as the kernel knows it."""

    PLANE = 0
    SPHERE = 1
    CAPSULE = 2
    BOX = 3
    CYLINDER = 4
    PRISM = 5
    MESH = 6


@dataclass(frozen=True)
class Collider:
    """An obstacle: a kind, and the size with which it starts in every world. Use the functions below to make one.

    `size` means, by kind: sphere (radius, -, -), capsule and cylinder (radius, half length, -), box (half sizes),
    prism (scale of its polygon, half length, -), mesh (scale, -, -), plane (-, -, -).
    """

    kind: ColliderKind
    size: tuple[float, float, float]
    polygon: np.ndarray | None = None
    """Cross-section of a prism, (P, 2) float64 [m], counter-clockwise."""
    vertices: np.ndarray | None = None
    """Vertices of a mesh, (V, 3) float32 [m]."""
    faces: np.ndarray | None = field(default=None)
    """Triangles of a mesh, (F, 3) int32."""

    def __post_init__(self) -> None:
        if not (np.isfinite(self.size).all() and min(self.size) > 0.0):
            raise ValueError(f"the sizes of a {self.kind.name.lower()} must be finite and > 0, got {self.size}")


def plane() -> Collider:
    """Return a half-space whose surface is the local plane z = 0; everything below is solid."""
    return Collider(ColliderKind.PLANE, (1.0, 1.0, 1.0))


def sphere(radius: float) -> Collider:
    """Return a sphere [m]."""
    return Collider(ColliderKind.SPHERE, (radius, 1.0, 1.0))


def capsule(radius: float, half_length: float) -> Collider:
    """Return a capsule along local z; `half_length` [m] is that of its straight part."""
    return Collider(ColliderKind.CAPSULE, (radius, half_length, 1.0))


def box(half_x: float, half_y: float, half_z: float) -> Collider:
    """Return a box with the given half sizes [m]."""
    return Collider(ColliderKind.BOX, (half_x, half_y, half_z))


def cylinder(radius: float, half_length: float) -> Collider:
    """Return a cylinder along local z [m]."""
    return Collider(ColliderKind.CYLINDER, (radius, half_length, 1.0))


def prism(polygon: np.ndarray, half_length: float) -> Collider:
    """Return a prism along local z.

    Args:
        polygon: Cross-section, convex, (P, 2) with P <= 16 [m].
        half_length: Half its height [m].

    Raises:
        ValueError: If the polygon is not simple and convex, or has too many vertices.
    """
    polygon = check_polygon(polygon, "the polygon of a prism")
    if len(polygon) > MAX_POLYGON_VERTICES:
        raise ValueError(f"the polygon of a prism has at most {MAX_POLYGON_VERTICES} vertices, got {len(polygon)}")
    forward = np.roll(polygon, -1, axis=0) - polygon
    backward = np.roll(forward, 1, axis=0)
    if (backward[:, 0] * forward[:, 1] - backward[:, 1] * forward[:, 0] < 0.0).any():
        raise ValueError("the polygon of a prism must be convex")
    return Collider(ColliderKind.PRISM, (1.0, half_length, 1.0), polygon=polygon)


def triangle_mesh(vertices: np.ndarray, faces: np.ndarray) -> Collider:
    """Return a closed triangle mesh.

    Args:
        vertices: (V, 3) [m].
        faces: Vertex indices, counter-clockwise from outside, (F, 3).

    Raises:
        ValueError: If a shape does not fit, a vertex is not finite, or an index is out of range.
    """
    vertices, faces = np.asarray(vertices, dtype=np.float32), np.asarray(faces, dtype=np.int32)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices must be finite and (V, 3), got shape {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
        raise ValueError(f"faces must be (F >= 1, 3), got shape {faces.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"faces must index {len(vertices)} vertices, got {faces.min()} to {faces.max()}")
    return Collider(ColliderKind.MESH, (1.0, 1.0, 1.0), vertices=vertices, faces=faces)
