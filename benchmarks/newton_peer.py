"""The same object in Newton: masses, springs and bending of a `Model`, a table, held nodes moved as kinematic particles.

Newton gets every advantage there is: the whole control step is recorded once as a Warp graph, self-contact is off, no forces are
cleared, vertex colours for VBD follow the springs. `bare` leaves out bending and the table as well, which ours always computes.
"""

from __future__ import annotations

import newton
import numpy as np
import trimesh
import warp as wp

from maniskill_grpd.physics import Model

BEND_STIFFNESS = 1e-5
"""Flexural rigidity of the cloth, the default of `ClothMaterial` [N m]."""
TABLE_HEIGHT = -10.0
"""The table lies far below: contact is looked for in every substep, and never found."""


@wp.kernel
def move_held_particles(
    particles: wp.array(dtype=int),
    starts: wp.array(dtype=wp.vec3),
    targets: wp.array(dtype=wp.vec3),
    progress: float,
    positions: wp.array(dtype=wp.vec3),
):
    """Put each held particle on the line from where it was to where it goes."""
    index = wp.tid()
    positions[particles[index]] = starts[index] + (targets[index] - starts[index]) * progress


class NewtonSolver:
    """B worlds of one model under `newton.solvers.SolverXPBD` or `SolverVBD`.

    Attributes:
        targets: Where the held nodes will be after the next step, (B * H,) wp.vec3 [m]; assign a flat array to it.
    """

    def __init__(
        self,
        model: Model,
        num_worlds: int,
        held: np.ndarray,
        *,
        method: str,
        substeps: int,
        iterations: int,
        bare: bool = False,
        control_dt: float = 0.05,
        device: str = "cpu",
    ) -> None:
        self.num_worlds, self.num_nodes, self.substeps = num_worlds, model.num_nodes, substeps
        self.dt = control_dt / substeps
        self.device = device
        self.method, self.bare = method, bare
        builder = self._build(model, num_worlds, held)
        builder.set_coloring(color_vertices(model, num_worlds))
        with wp.ScopedDevice(device):
            self.model = builder.finalize(device=device)
            self.model.particle_max_velocity = 1e6
            solvers = {"xpbd": newton.solvers.SolverXPBD, "vbd": newton.solvers.SolverVBD}
            self.solver = solvers[method](self.model, iterations=iterations)
            self.states = [self.model.state(), self.model.state()]
            self.control = self.model.control()
            self.pipeline = None if bare else newton.CollisionPipeline(self.model)
            self.contacts = None if bare else self.pipeline.contacts()
            offsets = np.arange(num_worlds)[:, None] * model.num_nodes
            self.particles = wp.array((offsets + held[None, :]).ravel().astype(np.int32), dtype=int)
            start = np.tile(model.rest_positions[held], (num_worlds, 1)).astype(np.float32)
            self.starts, self.targets = wp.array(start, dtype=wp.vec3), wp.array(start, dtype=wp.vec3)
        self._initial = self.states[0].particle_q.numpy().copy()
        self._simulate()  # compile before recording
        with wp.ScopedCapture(device=device) as capture:
            self._simulate()
        self._graph = capture.graph
        self.reset()

    def step(self) -> None:
        """Advance all worlds by one control step."""
        wp.capture_launch(self._graph)

    def reset(self) -> None:
        """Put all worlds at rest in the rest shape."""
        for state in self.states:
            state.particle_q.assign(self._initial)
            state.particle_qd.zero_()
        start = self._initial.reshape(-1, 3)[self.particles.numpy()]
        self.starts.assign(start)
        self.targets.assign(start)

    @property
    def positions(self) -> np.ndarray:
        """Node positions, (B, N, 3) [m]."""
        return self.states[0].particle_q.numpy().reshape(self.num_worlds, self.num_nodes, 3)

    def _build(self, model: Model, num_worlds: int, held: np.ndarray) -> newton.ModelBuilder:
        world = newton.ModelBuilder(gravity=(0.0, 0.0, -9.81))
        masses = model.masses.astype(float).copy()
        masses[held] = 0.0
        # Radius 0 switches particle contacts off, which would otherwise act between worlds as well.
        world.add_particles(
            [wp.vec3(*p) for p in model.rest_positions.tolist()],
            [wp.vec3(0.0)] * model.num_nodes,
            masses.tolist(),
            radius=[0.0] * model.num_nodes,
        )
        for (i, j), compliance in zip(model.edges.tolist(), model.stretch_compliances.tolist(), strict=True):
            world.add_spring(i, j, 1.0 / compliance, 0.0, 0.0)
        if not self.bare:
            self._add_bending(world, model)
        builder = newton.ModelBuilder(gravity=(0.0, 0.0, -9.81))
        builder.replicate(world, num_worlds)
        if not self.bare:
            builder.add_ground_plane(height=TABLE_HEIGHT)
        return builder

    def _add_bending(self, world: newton.ModelBuilder, model: Model) -> None:
        """Add hinges of stiffness 3 B e^2 / A per angle (edge e, both triangles A), or springs over two segments of a rope."""
        for i, j, left, right in mesh_hinges(model).tolist():
            x = model.rest_positions[[i, j, left, right]].astype(float)
            edge = np.linalg.norm(x[1] - x[0])
            area = 0.5 * sum(np.linalg.norm(np.cross(x[1] - x[0], x[other] - x[0])) for other in (2, 3))
            stiffness = 3.0 * BEND_STIFFNESS * edge**2 / area
            # Newton's VBD multiplies by the length of the edge, its XPBD does not.
            if self.method == "vbd":
                stiffness /= edge
            world.add_edge(left, right, i, j, edge_ke=stiffness, edge_kd=0.0)
        if len(model.faces):
            return
        for (previous, _, following), compliance in zip(model.bends.tolist(), model.bend_compliances.tolist(), strict=True):
            world.add_spring(previous, following, 1.0 / compliance, 0.0, 0.0)

    def _simulate(self) -> None:
        for substep in range(self.substeps):
            first, second = self.states
            wp.launch(
                move_held_particles,
                dim=len(self.particles),
                device=self.device,
                inputs=[self.particles, self.starts, self.targets, (substep + 1) / self.substeps, first.particle_q],
            )
            if self.pipeline is not None:
                self.pipeline.collide(first, self.contacts)
            self.solver.step(first, second, self.control, self.contacts, self.dt)
            self.states = [second, first]
        if self.substeps % 2:  # a recorded graph must begin and end with the same arrays
            first, second = self.states
            wp.copy(second.particle_q, first.particle_q)
            wp.copy(second.particle_qd, first.particle_qd)
            self.states = [second, first]
        wp.copy(self.starts, self.targets)


def mesh_hinges(model: Model) -> np.ndarray:
    """Return both nodes of each inner edge of the mesh and the two opposite it, (H, 4); none for a rope."""
    if not len(model.faces):
        return np.zeros((0, 4), np.int64)
    surface = trimesh.Trimesh(model.rest_positions, model.faces, process=False)
    return np.column_stack([surface.face_adjacency_edges, surface.face_adjacency_unshared])


def color_vertices(model: Model, num_worlds: int) -> list[np.ndarray]:
    """Colour nodes greedily so that no spring joins two of one colour; the same colours in every world."""
    colors = np.full(model.num_nodes, -1)
    neighbors: list[set[int]] = [set() for _ in range(model.num_nodes)]
    pairs = model.edges.tolist() + model.bends[:, [0, 2]].tolist() + mesh_hinges(model)[:, 2:].tolist()
    for i, j in pairs:
        neighbors[i].add(j)
        neighbors[j].add(i)
    for node in range(model.num_nodes):
        taken = {colors[other] for other in neighbors[node]}
        colors[node] = next(color for color in range(len(taken) + 1) if color not in taken)
    offsets = np.arange(num_worlds)[:, None] * model.num_nodes
    return [(offsets + np.flatnonzero(colors == color)).ravel().astype(np.int32) for color in range(colors.max() + 1)]
