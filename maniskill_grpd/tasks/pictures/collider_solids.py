"""What the obstacles of a world look like."""

from __future__ import annotations

import trimesh

from maniskill_grpd.physics import Solver
from maniskill_grpd.physics.colliders import ColliderKind
from maniskill_grpd.rendering.bodies import collider_body
from maniskill_grpd.tasks.pictures.drawing import Solid


def collider_solids(solver: Solver, world: int) -> tuple[Solid, ...]:
    """Return the obstacles that stand in a world; planes, which have no end, are left out."""
    positions, rotations, sizes, active = (
        values[world].cpu().numpy()
        for values in (solver.collider_positions, solver.collider_rotations, solver.collider_sizes, solver.collider_active)
    )
    solids = []
    for k, collider in enumerate(solver.colliders):
        if active[k] and collider.kind is not ColliderKind.PLANE:
            body, turn = collider_body(collider), trimesh.transformations.quaternion_matrix(rotations[k])[:3, :3]
            solids.append(Solid(body.vertices(sizes[k]) @ turn.T + positions[k], body.faces))
    return tuple(solids)
