"""Normalisation of vector channels that keeps their directions."""

from __future__ import annotations

import torch
from torch import nn

_FLOOR = 1e-3
"""Root mean square length below which vectors are no longer brought to unit length."""


class VectorNorm(nn.Module):
    r"""One scale per node for all vector channels.

        V_d <- g_d V_d / sqrt(mean_d |V_d|^2 + 1e-6)

    No mean is subtracted and no component has a scale of its own: either would break the symmetry.
    Lengths relative to each other survive, the length of all together does not; it should have been
    read into the scalars before. Zero stays zero.

    Shapes: V (3, ..., D) -> (3, ..., D).
    Symmetry: equivariant under O(3).

    Args:
        vector_dim: D.
    """

    def __init__(self, vector_dim: int) -> None:
        super().__init__()
        self.gain = nn.Parameter(torch.ones(vector_dim))

    def forward(self, vectors: torch.Tensor) -> torch.Tensor:
        """Scale vectors V."""
        square = vectors.square().sum(0).mean(-1, keepdim=True)
        return vectors * ((square + _FLOOR**2).rsqrt() * self.gain)
