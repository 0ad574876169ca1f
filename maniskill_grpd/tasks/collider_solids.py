"""Pictures of the obstacles of a world."""

from __future__ import annotations

import numpy as np
import trimesh

from maniskill_grpd.physics import Solver
from maniskill_grpd.physics.colliders import ColliderKind
from maniskill_grpd.tasks.drawing import Solid


def collider_solids(solver: Solver, world: int) -> tuple[Solid, ...]:
    """Return the active capsules and cylinders of a world as solids."""
    solids = []
    for index, collider in enumerate(solver.colliders):
        if not solver.collider_active[world, index]:
            continue
        radius, half_length, _ = solver.collider_sizes[world, index].tolist()
        create = {ColliderKind.CAPSULE: trimesh.creation.capsule, ColliderKind.CYLINDER: trimesh.creation.cylinder}
        mesh = create[collider.kind](radius=radius, height=2.0 * half_length)
        if collider.kind == ColliderKind.CAPSULE:
            mesh.apply_translation([0.0, 0.0, -mesh.bounds.mean(axis=0)[2]])
        pose = trimesh.transformations.quaternion_matrix(solver.collider_rotations[world, index].cpu().numpy())
        pose[:3, 3] = solver.collider_positions[world, index].cpu().numpy()
        mesh.apply_transform(pose)
        solids.append(Solid(np.asarray(mesh.vertices), np.asarray(mesh.faces)))
    return tuple(solids)
