"""Mean actions from features without symmetry."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.norm_limit import limit_norm

_INITIAL_GAIN = 0.01
"""Gain of the last layer, the usual one of policy networks: the untrained mean is nearly zero."""


class RawDecoder(nn.Module):
    r"""Mean action mu = W_2 silu(W_1 h) (eq. 44, 50), the last layer small and orthogonal.

    The length is bounded like that of the other decoders, unless `bounded` is False.

    Shapes: h (..., C) -> (..., 3); vectors are taken and ignored, as all decoders are called alike.
    Symmetry: none under rotations; the same map for every actuator.

    Args:
        dim: C.
        bounded: Whether the length stays below 1.2.
    """

    def __init__(self, dim: int, bounded: bool = True) -> None:
        super().__init__()
        self.bounded = bounded
        self.network = nn.Sequential(nn.Linear(dim, dim), nn.SiLU(), nn.Linear(dim, 3))
        nn.init.orthogonal_(self.network[-1].weight, _INITIAL_GAIN)
        nn.init.zeros_(self.network[-1].bias)

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Mean actions (..., 3) of actuators with features h."""
        action = self.network(scalars)
        return limit_norm(action) if self.bounded else action
