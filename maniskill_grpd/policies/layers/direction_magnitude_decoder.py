"""Mean actions from actuator features."""

from __future__ import annotations

import math

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms

_DIRECTION_EPSILON = 1e-6
"""Stabiliser of the direction (eq. 51)."""
_INITIAL_MAGNITUDE = 0.1
"""Length of the mean action before training, in units of the largest action."""


class DirectionMagnitudeDecoder(nn.Module):
    r"""Mean action as direction times magnitude, one decoder for all actuators (eq. 48-54).

        v_raw = W_o (sigmoid(W_g x) * W_v V),   v_hat = v_raw / sqrt(|v_raw|^2 + 1e-12)    (51)
        c     = softplus(MLP_mag(x))  or  relu(MLP_mag(x)),   x = (h, |V|)                 (52)
        mu    = c v_hat                                                                    (54)

    The epsilon of eq. 51 stands under the root, where it also gives zero a gradient.
    softplus is the default because a magnitude that relu holds at zero has no gradient. Actions are
    in units of the largest displacement per step. The untrained decoder moves gently: c = 0.1.

    Shapes: h (..., C), V (3, ..., D) -> (..., 3).
    Symmetry: equivariant under SO(3) if V is.

    Args:
        scalar_dim: C.
        vector_dim: D.
        magnitude: "softplus" or "relu".
    """

    def __init__(self, scalar_dim: int, vector_dim: int, magnitude: str = "softplus") -> None:
        super().__init__()
        self.magnitude = magnitude
        self.mix = nn.Linear(vector_dim, vector_dim, bias=False)
        self.direction = nn.Linear(vector_dim, 1, bias=False)
        self.hidden = nn.Linear(scalar_dim + vector_dim, scalar_dim + vector_dim)
        self.length = nn.Linear(scalar_dim, 1)
        self.split = [scalar_dim, vector_dim]
        nn.init.orthogonal_(self.length.weight, 0.1)
        bias = _INITIAL_MAGNITUDE
        if magnitude == "softplus":
            bias = math.log(math.expm1(_INITIAL_MAGNITUDE))
        nn.init.constant_(self.length.bias, bias)

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Mean actions (..., 3) of actuators with features h, V."""
        invariant = torch.cat([scalars, vector_norms(vectors)], dim=-1)
        hidden, gate = self.hidden(invariant).split(self.split, dim=-1)
        mixed = self.mix(vectors) * torch.sigmoid(gate)
        raw = self.direction(mixed).squeeze(-1).movedim(0, -1)
        norm = (raw.square().sum(-1, keepdim=True) + _DIRECTION_EPSILON**2).sqrt()
        length = self.length(nn.functional.silu(hidden))
        activation = nn.functional.relu if self.magnitude == "relu" else nn.functional.softplus
        return activation(length) * (raw / norm)
