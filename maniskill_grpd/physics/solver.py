"""The batched solver: owns the state of all worlds and launches the fused kernel."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor

import torch
import warp as wp

from maniskill_grpd.physics.coloring import color_constraints
from maniskill_grpd.physics.kernels import step_worlds
from maniskill_grpd.physics.model import Model

STANDARD_GRAVITY = 9.81
# Below this many worlds a second thread costs more than it brings.
MIN_WORLDS_PER_THREAD = 16
# One warp is enough for ropes; a larger block only pays when a colour has more constraints than lanes.
CUDA_BLOCK_DIM = 64
# Distance [m] of grippers that hold nothing together: further apart than any world is wide.
NO_LEASH = 1.0e6


class Solver:
    """XPBD with small substeps for B worlds that hold the same object.

    Every state tensor is allocated once and shared with Warp: write into it, never rebind it. `step()` allocates nothing and does
    not synchronise with the host. World i of a batch does the same arithmetic whatever B and its place in the batch are, so
    trajectories are bitwise reproducible on one device.

    Attributes:
        positions: Node positions, (B, N, 3) [m].
        velocities: Node velocities, (B, N, 3) [m/s].
        inverse_masses: (B, N) [1/kg]; 0 fixes a node in space.
        gravity: (B, 3) [m/s^2].
        plane: Table of each world, (B, 4): unit normal n and offset c of the surface n . x = c [m].
        friction: Coulomb coefficient against the table, (B,).
        gripper_positions: (B, A, 3) [m], where the grippers are.
        gripper_targets: (B, A, 3) [m], where they will be after the next step; they move there in a straight line. `step()`
            draws targets together that are further apart than their leash.
        holder: Gripper that holds each node, -1 for free nodes, (B, N) int32.
        hold_offsets: Position of held nodes relative to their gripper, (B, N, 3) [m].
        leashes: Largest distance between each two grippers, (B, A, A) [m]: the length of the object between what they hold.
        frozen: Worlds that went non-finite, (B,) bool. They keep their last finite state and are skipped until reset.

    Limitations: no self-collision; friction and damping dissipate momentum; first order in the substep, with the numerical
    damping of implicit integration.
    """

    def __init__(
        self,
        model: Model,
        num_worlds: int,
        num_grippers: int = 4,
        *,
        control_dt: float = 0.05,
        substeps: int = 20,
        device: str | torch.device = "cpu",
        num_threads: int | None = None,
    ) -> None:
        """Allocate the state of all worlds, at rest in the rest shape, with nothing held.

        Args:
            model: The object.
            num_worlds: Number of worlds B, >= 1.
            num_grippers: Number of grippers A, >= 1.
            control_dt: Duration of one `step()` [s], > 0.
            substeps: XPBD substeps in one `step()`, >= 1. More substeps are stiffer and dearer.
            device: "cpu" or a CUDA device.
            num_threads: CPU threads that share the worlds; by default all cores, but at least 16 worlds per thread.

        Raises:
            ValueError: If a number is out of its range.
        """
        for name, value, low in (("num_worlds", num_worlds, 1), ("num_grippers", num_grippers, 1), ("substeps", substeps, 1)):
            if value < low:
                raise ValueError(f"{name} must be >= {low}, got {value}")
        if not control_dt > 0.0:
            raise ValueError(f"control_dt must be > 0 s, got {control_dt}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be >= 1, got {num_threads}")
        self.model = model
        self.num_worlds = num_worlds
        self.num_grippers = num_grippers
        self.control_dt = control_dt
        self.substeps = substeps
        self.device = torch.device(device)
        self._allocate_state()
        self._commands = self._record_commands(self._choose_num_threads(num_threads))
        self._pool = ThreadPoolExecutor(len(self._commands)) if len(self._commands) > 1 else None

    def step(self) -> None:
        """Advance all worlds by `control_dt`; afterwards `gripper_positions` equal `gripper_targets`."""
        if self.device.type == "cuda":
            self._commands[0].launch(stream=wp.stream_from_torch(torch.cuda.current_stream(self.device)))
        elif self._pool is None:
            self._commands[0].launch()
        else:
            for launched in [self._pool.submit(command.launch) for command in self._commands]:
                launched.result()

    def reset(
        self, world_idx: torch.Tensor, positions: torch.Tensor, gripper_nodes: torch.Tensor | None = None
    ) -> None:
        """Put some worlds at rest in given shapes; the other worlds are left bitwise unchanged.

        Args:
            world_idx: Worlds to reset, (b,) int64.
            positions: Their node positions, (b, N, 3) [m].
            gripper_nodes: Node at which each gripper closes, (A,) int64. It is held as a pivot: the gripper fixes the node's
                position and lets the rope turn about it. With None the grippers are opened and left where they are.

        Raises:
            ValueError: If a shape does not fit, or a position is not finite.
        """
        expected = (len(world_idx), self.model.num_nodes, 3)
        if tuple(positions.shape) != expected:
            raise ValueError(f"positions must be {expected} for {len(world_idx)} worlds, got {tuple(positions.shape)}")
        if not torch.isfinite(positions).all():
            raise ValueError("positions must be finite, got NaN or infinity")
        self.positions[world_idx] = positions.to(self.positions)
        self.velocities[world_idx] = 0.0
        self.frozen[world_idx] = False
        self.holder[world_idx] = -1
        self.hold_offsets[world_idx] = 0.0
        self.leashes[world_idx] = NO_LEASH
        if gripper_nodes is not None:
            self.grasp(world_idx, gripper_nodes)

    def grasp(self, world_idx: torch.Tensor, gripper_nodes: torch.Tensor) -> None:
        """Let gripper a of some worlds move to node `gripper_nodes[a]` (A,) and hold it there as a pivot."""
        if tuple(gripper_nodes.shape) != (self.num_grippers,):
            raise ValueError(f"gripper_nodes must be ({self.num_grippers},), got {tuple(gripper_nodes.shape)}")
        grippers = torch.arange(self.num_grippers, dtype=torch.int32, device=self.device)
        self.holder[world_idx[:, None], gripper_nodes] = grippers
        at_nodes = self.positions[world_idx[:, None], gripper_nodes]
        self.gripper_positions[world_idx] = at_nodes
        self.gripper_targets[world_idx] = at_nodes
        self.leashes[world_idx] = self._direct_leashes(gripper_nodes)

    def _direct_leashes(self, gripper_nodes: torch.Tensor) -> torch.Tensor:
        """Return the lengths between grippers with no third one on the way, `NO_LEASH` for the other pairs, (A, A).

        A pair with a third gripper in between is limited by the two shorter leashes already; limiting it again would overcorrect.
        """
        nodes = gripper_nodes.cpu()
        lengths = torch.as_tensor(self.model.geodesic_distances(nodes.numpy()))[nodes]
        detours = lengths[:, :, None] + lengths[None, :, :]  # (a, via, b)
        via_an_end = torch.eye(len(nodes), dtype=torch.bool)
        detours[via_an_end[:, :, None] | via_an_end[None, :, :]] = torch.inf
        is_direct = lengths < detours.amin(dim=1) * (1.0 - 1e-6)
        return torch.where(is_direct, lengths, NO_LEASH).to(self.device)

    def state(self) -> dict[str, torch.Tensor]:
        """Return everything that the next step depends on, each as a copy (B, D) in float32."""
        return {
            name: tensor.reshape(self.num_worlds, -1).to(torch.float32, copy=True)
            for name, tensor in self._state_tensors.items()
        }

    def set_state(self, state: dict[str, torch.Tensor], world_idx: torch.Tensor | None = None) -> None:
        """Restore what `state()` returned, for all worlds or for `world_idx` (b,) with rows (b, D).

        Raises:
            ValueError: If a group is missing or has the wrong width.
        """
        missing = sorted(set(self._state_tensors) - set(state))
        if missing:
            raise ValueError(f"the solver's state lacks {missing}; it needs {sorted(self._state_tensors)}")
        rows = slice(None) if world_idx is None else world_idx
        for name, tensor in self._state_tensors.items():
            value = state[name]
            width = math.prod(tensor.shape[1:])
            if value.ndim != 2 or value.shape[1] != width:
                raise ValueError(f"state {name!r} must be (worlds, {width}), got {tuple(value.shape)}")
            tensor[rows] = value.reshape(-1, *tensor.shape[1:]).to(tensor)

    def _allocate_state(self) -> None:
        shape, device = (self.num_worlds, self.model.num_nodes), self.device
        rest = torch.as_tensor(self.model.rest_positions, device=device)
        self.positions = rest.repeat(self.num_worlds, 1, 1)
        self.velocities = torch.zeros(*shape, 3, device=device)
        masses = torch.as_tensor(self.model.masses, device=device)
        self.inverse_masses = (1.0 / masses).repeat(self.num_worlds, 1)
        self.gravity = torch.tensor([0.0, 0.0, -STANDARD_GRAVITY], device=device).repeat(self.num_worlds, 1)
        self.plane = torch.tensor([0.0, 0.0, 1.0, 0.0], device=device).repeat(self.num_worlds, 1)
        self.friction = torch.full((self.num_worlds,), self.model.friction, device=device)
        self.gripper_positions = torch.zeros(self.num_worlds, self.num_grippers, 3, device=device)
        self.gripper_targets = torch.zeros_like(self.gripper_positions)
        self.holder = torch.full(shape, -1, dtype=torch.int32, device=device)
        self.hold_offsets = torch.zeros(*shape, 3, device=device)
        self.leashes = torch.full((self.num_worlds, self.num_grippers, self.num_grippers), NO_LEASH, device=device)
        self.frozen = torch.zeros(self.num_worlds, dtype=torch.bool, device=device)
        self._previous = torch.zeros_like(self.positions)
        self._backup = torch.zeros_like(self.positions)
        self._directions = torch.zeros(self.num_worlds, len(self.model.edges), 3, device=device)
        self._upper = torch.zeros(self.num_worlds, len(self.model.edges), device=device)
        self._multipliers = torch.zeros_like(self._upper)

    @property
    def _state_tensors(self) -> dict[str, torch.Tensor]:
        names = (
            "positions velocities inverse_masses gravity plane friction gripper_positions gripper_targets "
            "holder hold_offsets leashes frozen"
        ).split()
        return {name: getattr(self, name) for name in names}

    def _choose_num_threads(self, num_threads: int | None) -> int:
        if self.device.type == "cuda":
            return 1
        available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        wanted = num_threads or min(available, self.num_worlds // MIN_WORLDS_PER_THREAD)
        return max(1, min(wanted, self.num_worlds))

    def _record_commands(self, num_threads: int) -> list[wp.Launch]:
        """Record one launch per thread, each over a contiguous share of the worlds."""
        device = str(self.device)
        block_dim = CUDA_BLOCK_DIM if self.device.type == "cuda" else 1
        dt = self.control_dt / self.substeps
        constants = [*self._constraint_arrays(device), self.model.radius, math.exp(-self.model.damping * dt)]
        world_tensors = [
            (self.gravity, wp.vec3), (self.plane, wp.vec4), (self.friction, wp.float32), (self.inverse_masses, wp.float32),
            (self.holder, wp.int32), (self.hold_offsets, wp.vec3), (self.leashes, wp.float32),
            (self.gripper_targets, wp.vec3), (self.gripper_positions, wp.vec3), (self.positions, wp.vec3), (self.velocities, wp.vec3),
            (self.frozen, wp.bool), (self._previous, wp.vec3), (self._backup, wp.vec3),
            (self._directions, wp.vec3), (self._upper, wp.float32), (self._multipliers, wp.float32),
        ]  # fmt: skip
        commands = []
        for part in range(num_threads):
            worlds = slice(part * self.num_worlds // num_threads, (part + 1) * self.num_worlds // num_threads)
            arrays = [wp.from_torch(tensor[worlds], dtype=dtype) for tensor, dtype in world_tensors]
            commands.append(
                wp.launch(
                    step_worlds,
                    dim=(worlds.stop - worlds.start, block_dim),
                    inputs=[*constants, self.substeps, dt, *arrays],
                    device=device,
                    block_dim=block_dim,
                    record_cmd=True,
                )
            )
        return commands

    def _constraint_arrays(self, device: str) -> list[wp.array]:
        """Hand the constraints to Warp in the order of the kernel's arguments, bends sorted by colour."""
        model = self.model
        order, color_offsets = color_constraints(model.bends)
        return [
            wp.array(model.rest_lengths, dtype=float, device=device),
            wp.array(model.stretch_compliances, dtype=float, device=device),
            wp.array(model.bends[order], dtype=wp.vec3i, device=device),
            wp.array(model.bend_compliances[order], dtype=float, device=device),
            wp.array(color_offsets, dtype=int, device=device),
        ]
