"""Decoders that actuators do not share."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn


class PerActuator(nn.Module):
    r"""One decoder MLP_v per place in the list of actuators (section A.D.6).

        out_i = MLP_i(h_i, V_i),  i = 0 ... A - 1

    For grippers that differ. What is lost with the sharing: reordering actuators no longer reorders
    their actions, and a graph cannot have more actuators than there are decoders. With fewer, the
    last decoders rest.

    Shapes: h (B, A, C), V (3, B, A, D) -> (B, A, O).
    Symmetry: that of the decoders under rotations; none under permutations of actuators.

    Args:
        make: Builds one decoder, (..., C), (3, ..., D) -> (..., O).
        num_decoders: Largest number of actuators.
    """

    def __init__(self, make: Callable[[], nn.Module], num_decoders: int) -> None:
        super().__init__()
        self.decoders = nn.ModuleList(make() for _ in range(num_decoders))

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Decode each actuator with its own weights.

        Raises:
            ValueError: If there are more actuators than decoders.
        """
        count = scalars.shape[-2]
        if count > len(self.decoders):
            raise ValueError(
                f"the policy has independent decoders for {len(self.decoders)} actuators "
                f"(option num_decoders), the graph has {count}"
            )
        outputs = [decoder(scalars[..., i, :], vectors[..., i, :]) for i, decoder in enumerate(self.decoders[:count])]
        return torch.stack(outputs, dim=-2)
