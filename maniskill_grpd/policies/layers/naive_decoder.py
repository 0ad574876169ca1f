"""Mean actions without the split into direction and magnitude."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms
from maniskill_grpd.policies.layers.norm_limit import limit_norm

_INITIAL_GAIN = 0.1
"""Gain of the last map, so that the untrained policy moves gently."""


class NaiveDecoder(nn.Module):
    r"""Mean action as one vector (eq. 50), the ablation of eq. 51 and 52.

        mu = W_o (sigmoid(MLP(x)) * W_v V),   x = (h, |V|)

    A network from features to three numbers, as printed, would not be equivariant; what makes the
    head naive is that direction and length come out of one linear map. The length is bounded like that
    of the other decoders, smoothly and without turning the vector, unless `bounded` is False.

    Shapes: h (..., C), V (3, ..., D) -> (..., 3).
    Symmetry: equivariant under SO(3) if V is.

    Args:
        scalar_dim: C.
        vector_dim: D.
        bounded: Whether the length stays below 1.2.
    """

    def __init__(self, scalar_dim: int, vector_dim: int, bounded: bool = True) -> None:
        super().__init__()
        self.bounded = bounded
        self.mix = nn.Linear(vector_dim, vector_dim, bias=False)
        self.gate = nn.Sequential(nn.Linear(scalar_dim + vector_dim, scalar_dim), nn.SiLU(), nn.Linear(scalar_dim, vector_dim))
        self.output = nn.Linear(vector_dim, 1, bias=False)
        nn.init.orthogonal_(self.output.weight, _INITIAL_GAIN)

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Mean actions (..., 3) of actuators with features h, V."""
        gate = torch.sigmoid(self.gate(torch.cat([scalars, vector_norms(vectors)], dim=-1)))
        action = self.output(self.mix(vectors) * gate).squeeze(-1).movedim(0, -1)
        return limit_norm(action) if self.bounded else action
