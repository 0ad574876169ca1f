"""The state of a batch of worlds: the tensors that a solver owns and shares with the fused kernel."""

from __future__ import annotations

import math

import numpy as np
import torch

from maniskill_grpd.physics.colliders import Collider
from maniskill_grpd.physics.fields import FIELDS, Field
from maniskill_grpd.physics.memory import check_memory
from maniskill_grpd.physics.model import Model
from maniskill_grpd.physics.upload import geodesic_table


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
        self._sizes = {
            "nodes": self.num_nodes,
            "sheet_edges": max((len(model.edges) for model in models if not model.is_rope), default=0),
            "grippers": num_grippers,
            "colliders": len(colliders),
        }
        world_bytes = sum(field.num_bytes(self._sizes) for field in FIELDS.values())
        check_memory(f"{num_worlds} worlds", num_worlds * world_bytes, "their state", device)
        self._allocate_variants()
        self._allocate_state()

    @property
    def fields(self) -> dict[str, tuple[Field, torch.Tensor]]:
        """All fields of the state with their tensors, by name."""
        return {name: (field, getattr(self, name)) for name, field in FIELDS.items()}

    def state(self) -> dict[str, torch.Tensor]:
        """Return everything that the next step depends on, each as a copy (B, D) in float32."""
        return {
            name: tensor.reshape(self.num_worlds, -1).to(torch.float32, copy=True) for name, (_, tensor) in self._saved.items()
        }

    def check_state(self, state: dict[str, torch.Tensor], world_idx: torch.Tensor | None = None) -> None:
        """Check whether `set_state` takes a state; its arguments.

        Raises:
            ValueError: If a field is missing or unknown, or has the wrong shape or a value out of its range.
        """
        saved, count = self._saved, self.num_worlds if world_idx is None else len(world_idx)
        if missing := sorted(set(saved) - set(state)):
            raise ValueError(f"the solver's state lacks {missing}; it needs {sorted(saved)}")
        if unknown := sorted(set(state) - set(saved)):
            raise ValueError(f"the solver's state has no {unknown}; it needs {sorted(saved)}")
        for name, (_, tensor) in saved.items():
            width = math.prod(tensor.shape[1:])
            if tuple(state[name].shape) != (count, width):
                raise ValueError(f"state {name!r} must be ({count}, {width}), got {tuple(state[name].shape)}")
        last = {"variants": torch.full((count,), len(self.models) - 1, device=self.device)}
        last["grippers"] = torch.full((count,), self.num_grippers - 1, device=self.device)
        if "variants" in saved:
            FIELDS["variants"].check("state 'variants'", state["variants"].to(self.device), last)
            variants = state["variants"][:, 0].to(self.device, torch.int64)
        else:
            variants = self.variants.new_zeros(count, dtype=torch.int64)
        last["nodes"] = self._node_masks.sum(dim=1)[variants] - 1
        for name, (field, _) in saved.items():
            field.check(f"state {name!r}", state[name].to(self.device), last)

    def set_state(self, state: dict[str, torch.Tensor], world_idx: torch.Tensor | None = None) -> None:
        """Restore what `state()` returned, for all worlds or for `world_idx` (b,) with rows (b, D).

        Raises:
            ValueError: If the state does not fit, see `check_state`; nothing is changed then.
        """
        self.check_state(state, world_idx)
        rows = slice(None) if world_idx is None else world_idx
        for name, (_, tensor) in self._saved.items():
            tensor[rows] = state[name].reshape(-1, *tensor.shape[1:]).to(tensor)
        self.node_mask[rows] = self._node_masks[self.variants[rows].long()]

    @property
    def _saved(self) -> dict[str, tuple[Field, torch.Tensor]]:
        """Fields on which the future depends; those of variants, sheets and colliders only where there are any."""
        unused = {"variants"} if len(self.models) == 1 else set()
        return {
            name: (field, tensor)
            for name, (field, tensor) in self.fields.items()
            if field.is_saved and name not in unused and all(self._sizes[axis] > 0 for axis in field.shape)
        }

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
        """Allocate all fields at their start values, then write what the first model and the colliders say."""
        for name, field in FIELDS.items():
            setattr(self, name, field.allocate(self.num_worlds, self._sizes, self.device))
        self.node_mask = self._node_masks[:1].repeat(self.num_worlds, 1)
        self.positions[:] = self._rest_positions[0]
        self.inverse_masses[:] = self._inverse_masses[0]
        self.friction[:] = self._friction[0]
        self.damping[:] = self._damping[0]
        sizes = np.array([collider.size for collider in self.colliders], dtype=np.float32).reshape(-1, 3)
        self.collider_sizes[:] = torch.as_tensor(sizes, device=self.device)
