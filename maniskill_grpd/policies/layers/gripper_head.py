"""Open or close, from actuator features."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms


class GripperHead(nn.Module):
    r"""Logit of a closed gripper (eq. 56): P(g_v = 1) = sigmoid(MLP(x)), x = (h, |V|).

    Untrained it is close to a fair coin.

    Shapes: h (..., C), V (3, ..., D) -> (..., 1).
    Symmetry: invariant.

    Args:
        scalar_dim: C.
        vector_dim: D.
    """

    def __init__(self, scalar_dim: int, vector_dim: int) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(scalar_dim + vector_dim, scalar_dim), nn.SiLU(), nn.Linear(scalar_dim, 1))
        nn.init.orthogonal_(self.network[-1].weight, 0.01)
        nn.init.zeros_(self.network[-1].bias)

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
        """Logits (..., 1) of actuators with features h, V."""
        return self.network(torch.cat([scalars, vector_norms(vectors)], dim=-1))
