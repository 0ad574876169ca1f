"""From actuator features to an action distribution."""

from __future__ import annotations

import math

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms

_DIRECTION_EPSILON = 1e-6
"""Stabiliser of the direction (eq. 51)."""
_MIN_STD, _MAX_STD = 0.02, 2.0
"""Range of standard deviations, in units of the largest action."""
_INITIAL_MAGNITUDE = 0.1
"""Length of the mean action before training, in units of the largest action."""


class DirectionMagnitudeDecoder(nn.Module):
    r"""Mean action as direction times magnitude, one decoder for all actuators (eq. 48-54).

        v_raw = W_o (sigmoid(W_g x) * W_v V),   v_hat = v_raw / (|v_raw| + 1e-6)      (51)
        c     = softplus(MLP_mag(x))  or  relu(MLP_mag(x)),   x = (h, |V|)           (52)
        mu    = c v_hat                                                              (54)

    softplus is the default because a magnitude that relu holds at zero has no gradient. Actions are in
    units of the largest displacement per step. The untrained decoder moves gently: c = 0.1.

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
        # The square root has no gradient at exactly zero; the epsilon of eq. 51 alone is no cure.
        norm = (raw.square().sum(-1, keepdim=True) + _DIRECTION_EPSILON**2).sqrt()
        length = self.length(nn.functional.silu(hidden))
        activation = nn.functional.relu if self.magnitude == "relu" else nn.functional.softplus
        return activation(length) * (raw / norm)


class IsotropicStd(nn.Module):
    r"""One standard deviation per actuator: Sigma = sigma^2 I (eq. 54, 61).

        log sigma = log 0.02 + log(2 / 0.02) sigmoid(MLP(x) + b),   x = (h, |V|)

    The bounds are approached, never hit, so that the gradient does not vanish; b sets the initial
    value. An anisotropic Sigma in world axes would not be equivariant.

    Shapes: h (..., C), V (3, ..., D) -> (..., 1).
    Symmetry: invariant.

    Args:
        scalar_dim: C.
        vector_dim: D.
        init_std: sigma before training, inside (0.02, 2).
        state_dependent: False: one learned number for all states and actuators.
    """

    def __init__(
        self, scalar_dim: int, vector_dim: int, init_std: float, state_dependent: bool
    ) -> None:
        super().__init__()
        if not _MIN_STD < init_std < _MAX_STD:
            raise ValueError(f"init_std must be inside ({_MIN_STD}, {_MAX_STD}), got {init_std}")
        share = math.log(init_std / _MIN_STD) / math.log(_MAX_STD / _MIN_STD)
        bias = math.log(share / (1.0 - share))
        self.network: nn.Sequential | None = None
        if state_dependent:
            self.network = nn.Sequential(
                nn.Linear(scalar_dim + vector_dim, scalar_dim), nn.SiLU(), nn.Linear(scalar_dim, 1)
            )
            nn.init.orthogonal_(self.network[-1].weight, 0.01)
            nn.init.constant_(self.network[-1].bias, bias)
        else:
            self.bias = nn.Parameter(torch.tensor(bias))

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Standard deviations (..., 1) of actuators with features h, V."""
        if self.network is None:
            raw = self.bias.expand(*scalars.shape[:-1], 1)
        else:
            raw = self.network(torch.cat([scalars, vector_norms(vectors)], dim=-1))
        span = math.log(_MAX_STD / _MIN_STD)
        return torch.exp(math.log(_MIN_STD) + span * torch.sigmoid(raw))
