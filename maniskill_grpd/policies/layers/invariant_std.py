"""Exploration noise from actuator features."""

from __future__ import annotations

import math

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms

_MIN_STD, _MAX_STD = 0.02, 2.0
"""Range of standard deviations, in units of the largest action."""


class InvariantStd(nn.Module):
    r"""Standard deviations of each actuator: one, Sigma = sigma^2 I (eq. 54, 61), or one along its mean and one across it.

        log sigma = log 0.02 + log(2 / 0.02) sigmoid(MLP(x) + b),   x = (h, |V|)

    The bounds are approached, never hit, so that the gradient does not vanish; b sets the initial
    value. An anisotropic Sigma in world axes would not be equivariant.

    Shapes: h (..., C), V (3, ..., D) -> (..., K).
    Symmetry: invariant.

    Args:
        scalar_dim: C.
        vector_dim: D.
        init_std: sigma before training, inside (0.02, 2).
        state_dependent: False: learned numbers for all states and actuators.
        num_axes: K, 1 or 2.
    """

    def __init__(self, scalar_dim: int, vector_dim: int, init_std: float, state_dependent: bool, num_axes: int = 1) -> None:
        super().__init__()
        if not _MIN_STD < init_std < _MAX_STD:
            raise ValueError(f"init_std must be inside ({_MIN_STD}, {_MAX_STD}), got {init_std}")
        share = math.log(init_std / _MIN_STD) / math.log(_MAX_STD / _MIN_STD)
        bias = math.log(share / (1.0 - share))
        self.network: nn.Sequential | None = None
        if state_dependent:
            hidden = nn.Linear(scalar_dim + vector_dim, scalar_dim)
            self.network = nn.Sequential(hidden, nn.SiLU(), nn.Linear(scalar_dim, num_axes))
            nn.init.orthogonal_(self.network[-1].weight, 0.01)
            nn.init.constant_(self.network[-1].bias, bias)
        else:
            self.bias = nn.Parameter(torch.full((num_axes,), bias))

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Standard deviations (..., K) of actuators with features h, V."""
        if self.network is None:
            raw = self.bias.expand(*scalars.shape[:-1], len(self.bias))
        else:
            raw = self.network(torch.cat([scalars, vector_norms(vectors)], dim=-1))
        span = math.log(_MAX_STD / _MIN_STD)
        return torch.exp(math.log(_MIN_STD) + span * torch.sigmoid(raw))
