"""Mean actions from features without symmetry."""

from __future__ import annotations

import torch
from torch import nn

_INITIAL_GAIN = 0.01
"""Gain of the last layer, the usual one of policy networks: the untrained mean is nearly zero."""


class RawDecoder(nn.Module):
    r"""Mean action mu = W_2 silu(W_1 h) (eq. 44, 50), the last layer small and orthogonal.

    Shapes: h (..., C) -> (..., 3); vectors are taken and ignored, as all decoders are called alike.
    Symmetry: none under rotations; the same map for every actuator.

    Args:
        dim: C.
    """

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(dim, dim), nn.SiLU(), nn.Linear(dim, 3))
        nn.init.orthogonal_(self.network[-1].weight, _INITIAL_GAIN)
        nn.init.zeros_(self.network[-1].bias)

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Mean actions (..., 3) of actuators with features h."""
        return self.network(scalars)
