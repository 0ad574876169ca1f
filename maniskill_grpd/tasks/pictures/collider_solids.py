"""What the obstacles of a world look like."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from maniskill_grpd.physics import Collider, Solver
from maniskill_grpd.physics.colliders import ColliderKind
from maniskill_grpd.tasks.pictures.drawing import Solid

SECTIONS = 48
"""Sides of what is round."""

Size = tuple[float, float, float]


def collider_solids(solver: Solver, world: int) -> tuple[Solid, ...]:
    """Return the obstacles that stand in a world; planes, which have no end, are left out."""
    positions, rotations, sizes, active = (
        values[world].cpu().numpy()
        for values in (solver.collider_positions, solver.collider_rotations, solver.collider_sizes, solver.collider_active)
    )
    return tuple(
        _solid(collider, positions[k], rotations[k], tuple(sizes[k]))
        for k, collider in enumerate(solver.colliders)
        if active[k] and collider.kind is not ColliderKind.PLANE
    )


def _solid(collider: Collider, position: np.ndarray, rotation: np.ndarray, size: Size) -> Solid:
    mesh = _BUILDERS[collider.kind](collider, size)
    turn = trimesh.transformations.quaternion_matrix(rotation)[:3, :3]
    return Solid(mesh.vertices @ turn.T + position, np.asarray(mesh.faces))


def _prism(collider: Collider, size: Size) -> trimesh.Trimesh:
    """Return a convex polygon (P, 2), pulled up and down along z."""
    polygon = size[0] * collider.polygon
    ends = [np.pad(polygon, ((0, 0), (0, 1)), constant_values=z) for z in (-size[1], size[1])]
    return trimesh.convex.convex_hull(np.concatenate(ends))


_BUILDERS: dict[ColliderKind, Callable[[Collider, Size], trimesh.Trimesh]] = {
    ColliderKind.SPHERE: lambda _, size: trimesh.creation.icosphere(subdivisions=3, radius=size[0]),
    ColliderKind.CAPSULE: lambda _, size: trimesh.creation.capsule(
        radius=size[0], height=2.0 * size[1], count=[SECTIONS, SECTIONS // 2], transform=None
    ),
    ColliderKind.BOX: lambda _, size: trimesh.creation.box(extents=2.0 * np.array(size)),
    ColliderKind.CYLINDER: lambda _, size: trimesh.creation.cylinder(radius=size[0], height=2.0 * size[1], sections=SECTIONS),
    ColliderKind.PRISM: _prism,
    ColliderKind.MESH: lambda collider, size: trimesh.Trimesh(size[0] * collider.vertices, collider.faces, process=False),
}
