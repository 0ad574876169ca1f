"""From the channels of a node to its first features."""

from __future__ import annotations

from itertools import combinations

import torch
from torch import nn

from maniskill_grpd.policies.layers.channel_first_linear import ChannelFirstLinear

_SATURATIONS = (0.1, 0.02)
"""Lengths, in units of the channel's RMS, above which a copy of a vector is a mere direction."""
_LOG_FLOOR = 0.01
"""Length, in units of the channel's RMS, below which log-lengths no longer fall."""
_TINY = 1e-12
"""Under the root of squared lengths; their gradient is infinite at zero."""


class NodeEmbedding(nn.Module):
    r"""Lift input vectors and scalars (eq. 42, 43) to node features.

    Offsets range from the size of the object to the centimetre at which success is decided. One
    linear scale cannot show both, so every input vector v and gravity g appear as

        vectors:  v,  v / sqrt(|v|^2 + e^2) for e in (0.1, 0.02),  g
        scalars:  |v|,  log(|v|^2 + 0.01^2),  |g|,  dot products of all pairs among {v, g} and among
                  {v / sqrt(|v|^2 + 0.1^2), g},  the input scalars

    all equivariant or invariant, followed by one gated layer

        (a, b) = W_s scalars,   h = silu(a),   V = 2 sigmoid(b) * W_v vectors.

    Positions are no input: only their differences are, in the convolutions.

    Shapes: vectors (B, n, V, 3), scalars (B, n, S), gravity (B, 3) -> (B, n, C), (3, B, n, D).
    Symmetry: scalars invariant, vectors equivariant under O(3).

    Args:
        num_vectors: V.
        num_scalars: S.
        scalar_dim: C.
        vector_dim: D.
    """

    def __init__(self, num_vectors: int, num_scalars: int, scalar_dim: int, vector_dim: int) -> None:
        super().__init__()
        self.split = [scalar_dim, vector_dim]
        num_lifted, num_invariants = self.lifted_dims(num_vectors, num_scalars)
        self.to_vectors = ChannelFirstLinear(num_lifted, vector_dim, bias=False)
        self.to_scalars = ChannelFirstLinear(num_invariants, scalar_dim + vector_dim)

    def forward(self, vectors: torch.Tensor, scalars: torch.Tensor, gravity: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """First features h, V of nodes from their normalised channels."""
        return self.embed(*self.lift_graphs(vectors, scalars, gravity))

    def embed(self, lifted: torch.Tensor, invariants: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """First features h, V of nodes from what `lift_graphs` returned."""
        hidden, gate = self.to_scalars(invariants.transpose(0, 1)).split(self.split, dim=-1)
        return nn.functional.silu(hidden), self.to_vectors(lifted.permute(1, 2, 0, 3)) * (2.0 * torch.sigmoid(gate))

    @classmethod
    def lift_graphs(
        cls, vectors: torch.Tensor, scalars: torch.Tensor, gravity: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """As `lift`, with the axis of the graphs first: (B, L, 3, n) and (B, I, n)."""
        lifted, invariants = cls.lift(vectors, scalars, gravity)
        return lifted.permute(2, 0, 1, 3), invariants.transpose(0, 1)

    @staticmethod
    def lifted_dims(num_vectors: int, num_scalars: int) -> tuple[int, int]:
        """Numbers L of equivariant copies and I of invariants that `lift` makes."""
        num_pairs = num_vectors * (num_vectors + 1) // 2
        num_invariants = 2 * num_vectors + 1 + 2 * num_pairs + num_scalars
        return num_vectors * (1 + len(_SATURATIONS)) + 1, num_invariants

    @staticmethod
    def lift(vectors: torch.Tensor, scalars: torch.Tensor, gravity: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Equivariant copies (L, 3, B, n) and invariants (I, B, n) of inputs; nothing learned."""
        vectors = vectors.permute(2, 3, 0, 1).contiguous()  # (V, 3, B, n)
        gravity = gravity.t()[None, :, :, None].expand(1, *vectors.shape[1:])
        squared = vectors.square().sum(1)
        copies = [vectors * (squared[:, None] + e * e).rsqrt() for e in _SATURATIONS]
        invariant = torch.cat(
            [
                (squared + _TINY).sqrt(),
                0.25 * torch.log(squared + _LOG_FLOOR**2) + 1.0,
                (gravity.square().sum(1) + _TINY).sqrt(),
                _dots(torch.cat([vectors, gravity])),
                _dots(torch.cat([copies[0], gravity])),
                scalars.permute(2, 0, 1),
            ]
        )
        return torch.cat([vectors, *copies, gravity]), invariant


def _dots(vectors: torch.Tensor) -> torch.Tensor:
    """Dot products of all pairs of distinct vectors, (V, 3, ...) -> (V (V - 1) / 2, ...)."""
    products = [(first * second).sum(0) for first, second in combinations(vectors.unbind(0), 2)]
    return torch.stack(products) if products else vectors.new_zeros(0, *vectors.shape[2:])
