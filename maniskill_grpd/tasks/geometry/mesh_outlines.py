"""Outlines of flat meshes that tasks take as shapes of cloth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import trimesh

from maniskill_grpd.physics.mesh.flattening import flatten
from maniskill_grpd.physics.mesh.sewing import sew
from maniskill_grpd.physics.mesh.surface import curved_surface

GivenMesh = trimesh.Trimesh | Sequence[np.ndarray]
"""A mesh, or its vertices (V, 3) [m] and faces (F, 3)."""
STRAIGHT = 1e-4
"""Largest sine of the turn at a point of a rim that counts as straight."""


def is_mesh(given: Any) -> bool:
    """Return whether something is a mesh: a `trimesh.Trimesh`, or vertices (V, 3) and faces (F, 3)."""
    if isinstance(given, trimesh.Trimesh):
        return True
    return isinstance(given, Sequence) and len(given) == 2 and all(_has_three_columns(part) for part in given)


def _has_three_columns(given: Any) -> bool:
    if hasattr(given, "ndim"):
        return given.ndim == 2 and given.shape[1] == 3
    return isinstance(given, list) and len(given) > 0 and all(isinstance(row, Sequence) and len(row) == 3 for row in given)


def outline_of_mesh(given: GivenMesh, name: str) -> np.ndarray:
    """Return the rim of a flat mesh without the points on its straight sides, (P, 2) [m], in the plane of the mesh.

    Args:
        given: A mesh, see `is_mesh`.
        name: What to call it in messages.

    Raises:
        ValueError: If the mesh cannot be cloth, is not flat, or has holes; says why.
    """
    vertices, faces = (given.vertices, given.faces) if isinstance(given, trimesh.Trimesh) else given
    points, nodes, _ = sew(vertices, faces)
    surface = curved_surface(points, nodes)
    if not surface.loops:
        raise ValueError(f"{name} must be a flat mesh, got a closed one: it has no rim, and tasks lay a single layer")
    mesh = flatten(surface)
    if mesh is None:
        raise ValueError(f"{name} must be a flat mesh of one layer, got one that is curved or lies on itself")
    if len(mesh.loops) > 1:
        raise ValueError(
            f"{name} must be a mesh with one rim, got {len(mesh.loops)}: cut holes by the task's own options, "
            "holes of ClothFolding-v1, hole_center and hole_radius of ClothHanging-v1"
        )
    rim = mesh.points[mesh.loops[0]]
    forward = np.roll(rim, -1, axis=0) - rim
    forward = forward / np.linalg.norm(forward, axis=1, keepdims=True)
    backward = np.roll(forward, 1, axis=0)
    return rim[np.abs(backward[:, 0] * forward[:, 1] - backward[:, 1] * forward[:, 0]) > STRAIGHT]
