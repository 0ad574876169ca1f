"""The worlds of a solver as triangles: object, obstacles, grippers and table."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from maniskill_grpd.physics import Solver
from maniskill_grpd.physics.colliders import ColliderKind
from maniskill_grpd.physics.launches import quiet_warp
from maniskill_grpd.rendering import palette
from maniskill_grpd.rendering.bodies import Body, collider_body, gripper_body, table_body
from maniskill_grpd.rendering.kernels.placement import CAP_RINGS, TUBE_SIDES, Bodies, lay_tube, place_bodies
from maniskill_grpd.rendering.labels import Label
from maniskill_grpd.rendering.streams import warp_stream
from maniskill_grpd.rendering.triangle_scene import TriangleScene

GRIPPER_SUBDIVISIONS = 1
"""Fineness of the grippers' balls, 80 triangles each."""

Look = tuple[Label, palette.Color, palette.Color]
"""What triangles are, and the colours of front and back."""


@dataclass(frozen=True)
class RigidBodies:
    """What is neither object nor obstacle, gripper or table: K bodies."""

    bodies: Sequence[tuple[Body, Look]]
    place: Callable[[], tuple[torch.Tensor, torch.Tensor]]
    """Returns where they are, (B, K, 3) [m], and their unit quaternions (w, x, y, z), (B, K, 4)."""


class SolverScene:
    """Keeps a `TriangleScene` of all worlds of a solver; `update` brings it up to date.

    Cloth is the mesh of its nodes, seen from both sides. A rope is a tube of twelve sides with round ends. Planes, which have no
    end, are not drawn; the table is a square in the plane z = 0.

    Attributes:
        scene: What a `Rasterizer` takes.
    """

    def __init__(self, solver: Solver, *, has_table: bool = True, others: RigidBodies | None = None) -> None:
        """Lay out the triangles of a solver's object, colliders and grippers.

        Args:
            solver: The worlds; read by every `update`.
            has_table: Whether there is a table.
            others: Further bodies, such as the links of arms.
        """
        self._solver, self._others = solver, others
        self._colliders = [k for k, collider in enumerate(solver.colliders) if collider.kind is not ColliderKind.PLANE]
        self._is_rope = solver.model.is_rope
        self._num_object = (solver.num_nodes + 2 * CAP_RINGS) * TUBE_SIDES if self._is_rope else solver.num_nodes
        bodies = self._build_bodies(has_table)
        self._place = _BodyPlaces([body for body, _ in bodies], solver.num_worlds, solver.device)
        self.scene = self._lay_out(bodies)
        self._counts, self._radii = (
            torch.tensor([getattr(model, name) for model in solver.models], dtype=dtype, device=solver.device)
            for name, dtype in (("num_nodes", torch.int32), ("radius", torch.float32))
        )
        self.update()

    def update(self) -> None:
        """Let the scene show the state of the solver."""
        self._write_bodies()
        solver = self._solver
        with quiet_warp():
            wp.init()
            where = {"device": str(solver.device), "stream": warp_stream(solver.device)}
            vertices = wp.from_torch(self.scene.vertices, dtype=wp.vec3)
            if self._is_rope:
                rope = [wp.from_torch(solver.positions, dtype=wp.vec3)]
                rope += [wp.from_torch(tensor) for tensor in (solver.variants, self._counts, self._radii)]
                wp.launch(lay_tube, dim=solver.num_worlds, inputs=[*rope, vertices], **where)
            else:
                self.scene.vertices[:, : self._num_object] = solver.positions
            places = self._place
            dim = (solver.num_worlds, len(places.owners))
            wp.launch(place_bodies, dim=dim, inputs=[places.described(), self._num_object, vertices], **where)

    def _build_bodies(self, has_table: bool) -> list[tuple[Body, Look]]:
        """Return colliders, closed and open grippers, others and table, in the order in which `_write_bodies` places them."""
        solver = self._solver
        bodies = [(collider_body(solver.colliders[k]), (Label.OBSTACLE, palette.SOLID, palette.SOLID)) for k in self._colliders]
        for is_closed, color in ((True, palette.CLOSED_GRIPPER), (False, palette.OPEN_GRIPPER)):
            jaws = gripper_body(is_closed=is_closed, subdivisions=GRIPPER_SUBDIVISIONS)
            bodies += [(jaws, (Label.GRIPPER, color, color))] * solver.num_grippers
        if self._others is not None:
            bodies += self._others.bodies
        if has_table:
            bodies.append((table_body(), (Label.TABLE, palette.TABLE, palette.TABLE)))
        return bodies

    def _write_bodies(self) -> None:
        solver, place, num = self._solver, self._place, len(self._colliders)
        if num:
            place.positions[:, :num] = solver.collider_positions[:, self._colliders]
            place.rotations[:, :num] = solver.collider_rotations[:, self._colliders]
            place.sizes[:, :num] = solver.collider_sizes[:, self._colliders]
            place.active[:, :num] = solver.collider_active[:, self._colliders]
        for active in (solver.closed, ~solver.closed):
            end = num + solver.num_grippers
            place.positions[:, num:end] = solver.gripper_positions
            place.active[:, num:end] = active
            num = end
        if self._others is not None:
            end = num + len(self._others.bodies)
            place.positions[:, num:end], place.rotations[:, num:end] = self._others.place()

    def _lay_out(self, bodies: list[tuple[Body, Look]]) -> TriangleScene:
        """Join the triangles of each variant of the object, padded with empty ones, and those of the bodies."""
        solver, device = self._solver, self._solver.device
        objects = [_tube_faces(solver.num_nodes)] if self._is_rope else [model.faces for model in solver.models]
        size = max(len(faces) for faces in objects)
        objects = [np.pad(faces, ((0, size - len(faces)), (0, 0))) for faces in objects] * (
            len(solver.models) if self._is_rope else 1
        )
        starts = self._num_object + np.cumsum([0] + [len(body.basis) for body, _ in bodies])
        rigid = [body.faces + start for (body, _), start in zip(bodies, starts, strict=False)]
        triangles = np.stack([np.concatenate([faces, *rigid]) for faces in objects])
        kind = Label.ROPE if self._is_rope else Label.CLOTH
        looks = [(kind, palette.FRONT, palette.FRONT if self._is_rope else palette.BACK), *(look for _, look in bodies)]
        counts = [size, *(len(body.faces) for body, _ in bodies)]
        labels, fronts, backs = (
            torch.as_tensor(np.repeat(np.array(column, dtype), counts, axis=0), device=device)
            .expand(len(objects), *[-1] * np.ndim(column))
            .contiguous()
            for column, dtype in zip(zip(*looks, strict=True), (np.int32, np.float32, np.float32), strict=True)
        )
        return TriangleScene(
            torch.zeros(solver.num_worlds, int(starts[-1]), 3, device=device),
            torch.as_tensor(triangles.astype(np.int32), device=device),
            labels,
            solver.variants,
            fronts,
            backs,
        )


class _BodyPlaces:
    """Where the rigid bodies of all worlds are, (B, K, ...), and their vertices in the frames of the bodies."""

    def __init__(self, bodies: list[Body], num_worlds: int, device: torch.device) -> None:
        """Put all bodies at the origin, in unit size."""
        counts, shape = [len(body.basis) for body in bodies], (num_worlds, len(bodies))
        self.owners = torch.as_tensor(np.repeat(np.arange(len(bodies), dtype=np.int32), counts), device=device)
        basis = np.concatenate([body.basis for body in bodies]).astype(np.float32)
        self.basis = torch.as_tensor(basis, device=device)
        self.positions = torch.zeros(*shape, 3, device=device)
        self.rotations = torch.tensor([1.0, 0.0, 0.0, 0.0], device=device).repeat(*shape, 1)
        self.sizes = torch.ones(*shape, 3, device=device)
        self.active = torch.ones(shape, dtype=torch.bool, device=device)

    def described(self) -> Bodies:
        """Return the tensors as kernels take them."""
        bodies = Bodies()
        bodies.owners, bodies.basis = wp.from_torch(self.owners), wp.from_torch(self.basis, dtype=wp.vec3)
        bodies.positions, bodies.sizes = (wp.from_torch(tensor, dtype=wp.vec3) for tensor in (self.positions, self.sizes))
        bodies.rotations, bodies.active = wp.from_torch(self.rotations, dtype=wp.vec4), wp.from_torch(self.active)
        return bodies


def _tube_faces(num_nodes: int) -> np.ndarray:
    """Return the triangles of a tube of rings of vertices, (F, 3)."""
    ring, side = np.meshgrid(np.arange(num_nodes + 2 * CAP_RINGS - 1), np.arange(TUBE_SIDES), indexing="ij")
    following = (side + 1) % TUBE_SIDES
    a, b = ring * TUBE_SIDES + side, ring * TUBE_SIDES + following
    c, d = a + TUBE_SIDES, b + TUBE_SIDES
    return np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)
