"""Rigid obstacles, the same kinds in all worlds with a pose, a size and a switch in each."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np
import trimesh

from maniskill_grpd.physics.mesh.outlines import check_polygon

MAX_POLYGON_VERTICES = 16
SMALLEST_RELATIVE_AREA = 1e-12
"""Triangles of a mesh that are smaller than this share of its squared size have no normal worth the name."""


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
    """Return a closed triangle mesh, of one part or several.

    Which side of a face is solid follows from the order of its vertices: a mesh whose faces run the other way round would be
    solid everywhere but inside. Such a mesh is refused, and so is one with a gap, where inside and outside cannot be told apart.
    Vertices at the same place count as one. A part may lie in the interior of another; it is a cavity if its faces face into it.

    Args:
        vertices: (V, 3) [m].
        faces: Vertex indices, counter-clockwise from outside the solid, (F, 3).

    Raises:
        ValueError: If a shape does not fit, a vertex is not finite, an index is out of range, a face has no area, the mesh is not
            closed, or faces run clockwise; says which.
    """
    vertices, faces = np.asarray(vertices, dtype=np.float32), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices must be finite and (V, 3), got shape {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0 or faces.dtype.kind not in "iu":
        raise ValueError(f"faces must be whole numbers (F >= 1, 3), got {faces.dtype} of shape {faces.shape}")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"faces must index {len(vertices)} vertices, got {faces.min()} to {faces.max()}")
    _check_solid(trimesh.Trimesh(vertices.astype(np.float64), faces, process=True))
    return Collider(ColliderKind.MESH, (1.0, 1.0, 1.0), vertices=vertices, faces=faces.astype(np.int32))


def _check_solid(surface: trimesh.Trimesh) -> None:
    """Raise ValueError unless a surface, whose equal vertices are merged, bounds a solid with its faces counter-clockwise."""
    flat = np.flatnonzero(surface.area_faces <= SMALLEST_RELATIVE_AREA * surface.scale**2)
    if len(flat):
        raise ValueError(f"faces must have an area, {len(flat)} of {len(surface.faces)} have none, the first is face {flat[0]}")
    if not surface.is_watertight:
        uses = np.bincount(surface.edges_unique_inverse)
        raise ValueError(f"a mesh must be closed, {(uses != 2).sum()} of {len(uses)} edges do not join exactly two faces")
    if not surface.is_winding_consistent:
        raise ValueError("the faces of a mesh must all run the same way round, some neighbours do not")
    parts = surface.split(only_watertight=False)
    for index, part in enumerate(parts):
        around = [other.triangles for other in parts if other is not part]
        is_within = sum(_winding_number(triangles, part.vertices[0]) for triangles in around) > 0.5
        volume = _signed_volume(part.triangles)
        if not (volume > 0.0 or (volume < 0.0 and is_within)):
            raise ValueError(
                f"faces must run counter-clockwise seen from outside; those of part {index} of {len(parts)} enclose the signed "
                f"volume {volume:.3g} m^3: reverse them, faces[:, ::-1]"
            )


def _signed_volume(triangles: np.ndarray) -> float:
    """Return the volume that a closed surface (F, 3, 3) encloses, negative if it runs clockwise from outside [m^3]."""
    a, b, c = np.moveaxis(triangles, 1, 0)
    return float((a * np.cross(b, c)).sum() / 6.0)


def _winding_number(triangles: np.ndarray, point: np.ndarray) -> float:
    """Return how often a closed surface (F, 3, 3) surrounds a point (3,), from solid angles (van Oosterom and Strackee 1983)."""
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    volume = (a * np.cross(b, c)).sum(1)
    around = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
    return float(np.arctan2(volume, around).sum() / (2.0 * np.pi))
