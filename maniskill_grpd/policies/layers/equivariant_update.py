"""Node update from scalar and vector messages."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.vector_norm import VectorNorm

_TINY = 1e-6
"""Under the root of squared norms; their gradient is infinite at zero."""


def vector_norms(vectors: torch.Tensor) -> torch.Tensor:
    """Smoothed lengths of vector channels.

    Args:
        vectors: (3, ..., D).

    Returns:
        (..., D), invariant.
    """
    return (vectors.square().sum(0) + _TINY).sqrt()


class EquivariantUpdate(nn.Module):
    r"""Residual update phi of eq. 3, 37, 39 and 41.

        u  = W V + m_V
        z  = W_h h + W_u |u| + m_s
        h' = LayerNorm(h + W_o silu(z)),   V' = V + sigmoid(W_g silu(z)) * u

    The nonlinearity acts on invariants only; vectors are mixed linearly across channels and scaled
    by an invariant gate. By default vectors are not normalised: their lengths carry how far things
    are, and residual depth is small. In deep networks V' may pass through `VectorNorm`.

    Shapes: h (..., C), V (3, ..., D), m_s (..., H), m_V (3, ..., D) -> (..., C), (3, ..., D).
    Symmetry: scalars invariant, vectors equivariant under O(3), if messages are.

    Args:
        scalar_dim: C.
        vector_dim: D.
        message_dim: H, width of scalar messages and of the hidden layer.
        normalize_vectors: Whether V' is normalised.
    """

    def __init__(self, scalar_dim: int, vector_dim: int, message_dim: int, normalize_vectors: bool = False) -> None:
        super().__init__()
        self.scalar_dim = scalar_dim
        self.mix = nn.Linear(vector_dim, vector_dim, bias=False)
        self.hidden = nn.Linear(scalar_dim + vector_dim, message_dim)
        self.output = nn.Linear(message_dim, scalar_dim + vector_dim)
        self.norm = nn.LayerNorm(scalar_dim)
        self.vector_norm = VectorNorm(vector_dim) if normalize_vectors else None

    def forward(
        self, scalars: torch.Tensor, vectors: torch.Tensor, scalar_messages: torch.Tensor, vector_messages: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """New h, V of nodes from their h, V and messages m_s, m_V."""
        mixed = self.mix(vectors) + vector_messages
        invariant = torch.cat([scalars, vector_norms(mixed)], dim=-1)
        hidden = nn.functional.silu(self.hidden(invariant) + scalar_messages)
        change, gate = self.output(hidden).split([self.scalar_dim, mixed.shape[-1]], dim=-1)
        scalars = self.norm(scalars + change)
        vectors = torch.addcmul(vectors, mixed, torch.sigmoid(gate))
        return scalars, vectors if self.vector_norm is None else self.vector_norm(vectors)
