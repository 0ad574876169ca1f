"""What a receiver makes of the moments that it gathers."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.equivariant_update import vector_norms

SCALAR_PATHS = 2
"""Kinds of contractions to scalars: of scalars, and of vectors along the direction."""


class ReceiverGate(nn.Module):
    r"""Factors by which a receiver weighs moments before they are contracted, so that kernels depend on it (eq. 36, 38, 40).

        g = 2 sigmoid(W x_r + b),   x_r = (h_r, |V_r|)
        kappa_r(p) = sum_lb g_lb(h_r) a_lb phi_b(|p|) Y_l(p),   acting on g_c(h_r) h_s

    One factor per contraction l and radial function b, one per channel c that is sent. Both are the same for all senders,
    hence may wait until after the sum over senders: psi(h_s, h_r, p) costs a product per receiver, none per edge.

    Shapes: h_r (B, R, C), V_r (3, B, R, D) -> factors of the joined moments, to scalars (B, R, Q (F + G)) and
        to vectors (B, R, P Q G).
    Symmetry: invariant under O(3).

    Args:
        receiver_dims: C and D.
        sender_dims: Scalar and vector channels F and G that are sent.
        num_radial: Radial functions Q.
        num_vector_paths: Contractions to vectors P, of which the first is of scalars.
    """

    def __init__(
        self, receiver_dims: tuple[int, int], sender_dims: tuple[int, int], num_radial: int, num_vector_paths: int
    ) -> None:
        super().__init__()
        scalars, vectors = sender_dims
        self._paths = (SCALAR_PATHS + num_vector_paths, num_radial)
        # Scalars, scalars mixed for vectors, vectors.
        self._split = [self._paths[0] * num_radial, scalars, vectors, vectors]
        self.network = nn.Linear(sum(receiver_dims), sum(self._split))

    def forward(self, scalars: torch.Tensor, vectors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Factors from the features of the receivers."""
        invariant = torch.cat([scalars, vector_norms(vectors)], dim=-1)
        factors = 2.0 * torch.sigmoid(self.network(invariant))
        kernel, still, mixed, moved = factors.split(self._split, dim=-1)
        kernel = kernel.unflatten(-1, self._paths).unbind(-2)
        to_scalars = [_outer(kernel[0], still), _outer(kernel[1], moved)]
        to_vectors = [_outer(kernel[2], mixed), *(_outer(path, moved) for path in kernel[3:])]
        return torch.cat(to_scalars, dim=-1), torch.cat(to_vectors, dim=-1)


def _outer(kernel: torch.Tensor, channels: torch.Tensor) -> torch.Tensor:
    """Products of (..., Q) and (..., F) as (..., Q F)."""
    return (kernel.unsqueeze(-1) * channels.unsqueeze(-2)).flatten(-2)
