"""From the channels of a node to features, coordinates included as they are."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.channel_first_linear import ChannelFirstLinear
from maniskill_grpd.policies.layers.node_embedding import NodeEmbedding


class RawEmbedding(nn.Module):
    r"""Features of a node from raw coordinates, for policies without symmetry.

        x = (p / length_scale, all components of the lifted vectors, their invariants, scalars)
        h = LayerNorm(W_2 silu(W_1 x))

    The inputs are those of `NodeEmbedding`, at the same scales, so that what an equivariant policy
    can see at a centimetre's distance this one can see, too.

    Shapes: position (B, n, 3), vectors (B, n, V, 3), scalars (B, n, S), gravity (B, 3) ->
        (B, n, C).
    Symmetry: none. Neither rotations nor translations are respected.

    Args:
        num_vectors: V.
        num_scalars: S.
        dim: C.
        length_scale: Unit of positions [m].
    """

    def __init__(self, num_vectors: int, num_scalars: int, dim: int, length_scale: float) -> None:
        super().__init__()
        self.length_scale = length_scale
        num_lifted, num_invariants = NodeEmbedding.lifted_dims(num_vectors, num_scalars)
        self.input = ChannelFirstLinear(3 + 3 * num_lifted + num_invariants, dim)
        self.output = nn.Linear(dim, dim)
        self.norm = nn.LayerNorm(dim)

    def forward(
        self, position: torch.Tensor, vectors: torch.Tensor, scalars: torch.Tensor, gravity: torch.Tensor
    ) -> torch.Tensor:
        """First features of nodes from their positions [m] and normalised channels."""
        lifted, invariant = NodeEmbedding.lift(vectors, scalars, gravity)
        place = position.movedim(-1, 0) / self.length_scale
        features = torch.cat([place, lifted.flatten(0, 1), invariant])
        return self.norm(self.output(nn.functional.silu(self.input(features))))
