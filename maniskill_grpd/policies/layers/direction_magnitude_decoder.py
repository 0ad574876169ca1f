"""Mean actions from actuator features."""

from __future__ import annotations

import math

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms
from maniskill_grpd.policies.layers.norm_limit import LARGEST_LENGTH

_DIRECTION_EPSILON = 1e-6
"""Stabiliser of the direction (eq. 51)."""
_INITIAL_MAGNITUDE = 0.1
"""Length of the mean action before training, in units of the largest action."""


def _bounded(raw: torch.Tensor) -> torch.Tensor:
    return LARGEST_LENGTH * torch.sigmoid(raw)


_ACTIVATIONS = {"sigmoid": _bounded, "softplus": nn.functional.softplus, "relu": nn.functional.relu}


class DirectionMagnitudeDecoder(nn.Module):
    r"""Mean action as direction times magnitude, one decoder for all actuators (eq. 48-54).

        v_raw = W_o (sigmoid(W_g x) * W_v V),   v_hat = v_raw / sqrt(|v_raw|^2 + 1e-12)    (51)
        c     = 1.2 sigmoid(MLP_mag(x)),  softplus  or  relu,   x = (h, |V|)               (52)
        mu    = c v_hat                                                                    (54)

    The epsilon of eq. 51 stands under the root, where it also gives zero a gradient. Actions are in
    units of the largest displacement per step, beyond which the controller cuts them: a length that
    nothing bounds drifts on from there without any effect on the motion, while the angle that noise
    and a bounded step can turn it by shrinks. Hence the bound of 1.2. relu, as printed, has no gradient
    where it is zero. The untrained decoder moves gently: c = 0.1.

    Shapes: h (..., C), V (3, ..., D) -> (..., 3).
    Symmetry: equivariant under SO(3) if V is.

    Args:
        scalar_dim: C.
        vector_dim: D.
        magnitude: "sigmoid", "softplus" or "relu".
    """

    def __init__(self, scalar_dim: int, vector_dim: int, magnitude: str = "sigmoid") -> None:
        super().__init__()
        self.magnitude = magnitude
        self.mix = nn.Linear(vector_dim, vector_dim, bias=False)
        self.direction = nn.Linear(vector_dim, 1, bias=False)
        self.hidden = nn.Linear(scalar_dim + vector_dim, scalar_dim + vector_dim)
        self.length = nn.Linear(scalar_dim, 1)
        self.split = [scalar_dim, vector_dim]
        nn.init.orthogonal_(self.length.weight, 0.1)
        biases = {
            "sigmoid": -math.log(LARGEST_LENGTH / _INITIAL_MAGNITUDE - 1.0),
            "softplus": math.log(math.expm1(_INITIAL_MAGNITUDE)),
            "relu": _INITIAL_MAGNITUDE,
        }
        nn.init.constant_(self.length.bias, biases[magnitude])

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Mean actions (..., 3) of actuators with features h, V."""
        invariant = torch.cat([scalars, vector_norms(vectors)], dim=-1)
        hidden, gate = self.hidden(invariant).split(self.split, dim=-1)
        mixed = self.mix(vectors) * torch.sigmoid(gate)
        raw = self.direction(mixed).squeeze(-1).movedim(0, -1)
        norm = (raw.square().sum(-1, keepdim=True) + _DIRECTION_EPSILON**2).sqrt()
        length = self.length(nn.functional.silu(hidden))
        return _ACTIVATIONS[self.magnitude](length) * (raw / norm)
