"""The state of a batch of worlds: the tensors that a solver owns and shares with the fused kernel."""

from __future__ import annotations

import math

import numpy as np
import torch
import warp as wp

from maniskill_grpd.physics.colliders import Collider
from maniskill_grpd.physics.leashes import NO_LEASH
from maniskill_grpd.physics.model import Model
from maniskill_grpd.physics.upload import geodesic_table

STANDARD_GRAVITY = 9.81
# How the kernel reads the tensors of the state.
WORLD_TYPES = {
    "variants": wp.int32,
    "gravity": wp.vec3,
    "plane": wp.vec4,
    "friction": wp.float32,
    "damping": wp.float32,
    "stretch_scale": wp.float32,
    "bend_scale": wp.float32,
    "inverse_masses": wp.float32,
    "holder": wp.int32,
    "hold_offsets": wp.vec3,
    "gripper_nodes": wp.int32,
    "leashes": wp.float32,
    "gripper_targets": wp.vec3,
    "gripper_positions": wp.vec3,
    "gripper_forces": wp.vec3,
    "positions": wp.vec3,
    "velocities": wp.vec3,
    "frozen": wp.bool,
}


class WorldState:
    """Allocates the tensors that `Solver` documents, saves and restores them."""

    def __init__(
        self, models: tuple[Model, ...], num_worlds: int, num_grippers: int, colliders: tuple[Collider, ...], device: torch.device
    ) -> None:
        """Put the first variant into all worlds, at rest in its rest shape and held by nobody."""
        self.models = models
        self.model = models[0]
        self.num_worlds = num_worlds
        self.num_grippers = num_grippers
        self.num_nodes = max(model.num_nodes for model in models)
        self.colliders = colliders
        self.device = device
        self._allocate_variants()
        self._allocate_state()
        self._allocate_colliders()

    def state(self) -> dict[str, torch.Tensor]:
        """Return everything that the next step depends on, each as a copy (B, D) in float32."""
        return {
            name: tensor.reshape(self.num_worlds, -1).to(torch.float32, copy=True) for name, tensor in self._state_tensors.items()
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
        self.node_mask[rows] = self._node_masks[self.variants[rows].long()]

    @property
    def _state_tensors(self) -> dict[str, torch.Tensor]:
        names = [
            "positions",
            "velocities",
            "inverse_masses",
            "gravity",
            "plane",
            "friction",
            "damping",
            "stretch_scale",
            "bend_scale",
            "gripper_positions",
            "gripper_targets",
            "gripper_nodes",
            "closed",
            "holder",
            "hold_offsets",
            "leashes",
            "frozen",
        ]
        if len(self.models) > 1:
            names.append("variants")
        if self.colliders:
            names += ["collider_positions", "collider_rotations", "collider_sizes", "collider_active"]
        return {name: getattr(self, name) for name in names}

    def _allocate_variants(self) -> None:
        """Tabulate what differs between variants, padded to N nodes: (M, N, ...)."""
        device, count = self.device, len(self.models)
        self._geodesics = torch.as_tensor(geodesic_table(self.models), device=device)
        self._rest_positions = torch.zeros(count, self.num_nodes, 3, device=device)
        self._inverse_masses = torch.zeros(count, self.num_nodes, device=device)
        self._node_masks = torch.zeros(count, self.num_nodes, dtype=torch.bool, device=device)
        for index, model in enumerate(self.models):
            self._rest_positions[index, : model.num_nodes] = torch.as_tensor(model.rest_positions)
            self._inverse_masses[index, : model.num_nodes] = 1.0 / torch.as_tensor(model.masses)
            self._node_masks[index, : model.num_nodes] = True
        self._friction = torch.tensor([model.friction for model in self.models], device=device)
        self._damping = torch.tensor([model.damping for model in self.models], device=device)

    def _allocate_state(self) -> None:
        shape, device = (self.num_worlds, self.num_nodes), self.device
        self.variants = torch.zeros(self.num_worlds, dtype=torch.int32, device=device)
        self.node_mask = self._node_masks[:1].repeat(self.num_worlds, 1)
        self.positions = self._rest_positions[:1].repeat(self.num_worlds, 1, 1)
        self.velocities = torch.zeros(*shape, 3, device=device)
        self.inverse_masses = self._inverse_masses[:1].repeat(self.num_worlds, 1)
        self.gravity = torch.tensor([0.0, 0.0, -STANDARD_GRAVITY], device=device).repeat(self.num_worlds, 1)
        self.plane = torch.tensor([0.0, 0.0, 1.0, 0.0], device=device).repeat(self.num_worlds, 1)
        self.friction = torch.full((self.num_worlds,), self.model.friction, device=device)
        self.damping = torch.full((self.num_worlds,), self.model.damping, device=device)
        self.stretch_scale = torch.ones(self.num_worlds, device=device)
        self.bend_scale = torch.ones(self.num_worlds, device=device)
        self.gripper_positions = torch.zeros(self.num_worlds, self.num_grippers, 3, device=device)
        self.gripper_targets = torch.zeros_like(self.gripper_positions)
        self.gripper_forces = torch.zeros_like(self.gripper_positions)
        self.gripper_nodes = torch.full((self.num_worlds, self.num_grippers), -1, dtype=torch.int32, device=device)
        self.closed = torch.zeros(self.num_worlds, self.num_grippers, dtype=torch.bool, device=device)
        self.holder = torch.full(shape, -1, dtype=torch.int32, device=device)
        self.hold_offsets = torch.zeros(*shape, 3, device=device)
        self.leashes = torch.full((self.num_worlds, self.num_grippers, self.num_grippers), NO_LEASH, device=device)
        self.frozen = torch.zeros(self.num_worlds, dtype=torch.bool, device=device)
        self.dropped_contacts = torch.zeros(self.num_worlds, dtype=torch.int32, device=device)

    def _allocate_colliders(self) -> None:
        device, shape = self.device, (self.num_worlds, len(self.colliders))
        self.collider_positions = torch.zeros(*shape, 3, device=device)
        self.collider_rotations = torch.tensor([1.0, 0.0, 0.0, 0.0], device=device).repeat(*shape, 1)
        sizes = np.array([collider.size for collider in self.colliders], dtype=np.float32).reshape(-1, 3)
        self.collider_sizes = torch.as_tensor(sizes, device=device).repeat(self.num_worlds, 1, 1)
        self.collider_active = torch.ones(shape, dtype=torch.bool, device=device)
