"""What belongs to an episode beside the state of the solver: goals, counters, directions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import torch

Kind = Literal["position", "vector", "scalar"]
"""How a tensor changes when its world is moved: positions rotate and shift, vectors rotate, scalars stay."""


class EpisodeTensors:
    """Named tensors (B, ...), float32, that are part of the state of every world.

    Args:
        num_worlds: Number of worlds B.
        device: Where they live.
    """

    def __init__(self, num_worlds: int, device: torch.device) -> None:
        self._num_worlds, self._device = num_worlds, device
        self._tensors: dict[str, torch.Tensor] = {}
        self._kinds: dict[str, Kind] = {}

    def allocate(self, name: str, *shape: int, kind: Kind) -> torch.Tensor:
        """Return zeros (B, *shape), to be written in place; the last dimension of positions and vectors is 3."""
        if kind != "scalar" and shape[-1:] != (3,):
            raise ValueError(f"a {kind} such as {name!r} must be (..., 3), got {shape}")
        self._tensors[name] = torch.zeros(self._num_worlds, *shape, device=self._device)
        self._kinds[name] = kind
        return self._tensors[name]

    def state(self) -> dict[str, torch.Tensor]:
        """Return copies of all tensors, (B, D)."""
        return {name: tensor.reshape(self._num_worlds, -1).clone() for name, tensor in self._tensors.items()}

    def set_state(self, state: Mapping[str, torch.Tensor], worlds: torch.Tensor) -> None:
        """Restore rows (b, D) of `state()` for some worlds (b,)."""
        for name, tensor in self._tensors.items():
            tensor[worlds] = state[name].view(-1, *tensor.shape[1:])

    def move(self, rotation: torch.Tensor, translation: torch.Tensor) -> None:
        """Move all worlds rigidly: x -> R x + t with rotations (B, 3, 3) and translations (B, 3) [m]."""
        for name, tensor in self._tensors.items():
            if self._kinds[name] == "scalar":
                continue
            rows = tensor.view(self._num_worlds, -1, 3) @ rotation.mT
            if self._kinds[name] == "position":
                rows = rows + translation[:, None]
            tensor.copy_(rows.view_as(tensor))
