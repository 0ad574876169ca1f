"""From the channels of a node to scalar and vector features, coordinates included as they are."""

from __future__ import annotations

import torch
from torch import nn

from maniskill_grpd.policies.layers.channel_first_linear import ChannelFirstLinear
from maniskill_grpd.policies.layers.node_embedding import NodeEmbedding


class RawNodeEmbedding(nn.Module):
    r"""What `NodeEmbedding` is, without its symmetry: the one layer in which a network is equivariant or not.

        x = (p / length_scale, all components of the lifted vectors)
        (a, b) = W_s (x, invariants, scalars),   h = silu(a),   V = 2 sigmoid(b) * W_v x

    W_v is any linear map to 3 D numbers, where that of `NodeEmbedding` treats the three components of a vector alike. The lifted
    vectors and invariants are those of `NodeEmbedding`, so that nothing is seen less well.

    Shapes: position (B, n, 3), vectors (B, n, V, 3), scalars (B, n, S), gravity (B, 3) -> (B, n, C), (3, B, n, D).
    Symmetry: none. Neither rotations nor translations are respected.

    Args:
        num_vectors: V.
        num_scalars: S.
        scalar_dim: C.
        vector_dim: D.
        length_scale: Unit of positions [m].
    """

    def __init__(self, num_vectors: int, num_scalars: int, scalar_dim: int, vector_dim: int, length_scale: float) -> None:
        super().__init__()
        self.length_scale = length_scale
        self.split = [scalar_dim, vector_dim]
        num_lifted, num_invariants = NodeEmbedding.lifted_dims(num_vectors, num_scalars)
        num_components = 3 * (num_lifted + 1)
        self.to_vectors = ChannelFirstLinear(num_components, 3 * vector_dim, bias=False)
        self.to_scalars = ChannelFirstLinear(num_components + num_invariants, scalar_dim + vector_dim)

    def forward(
        self, position: torch.Tensor, vectors: torch.Tensor, scalars: torch.Tensor, gravity: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """First features h, V of nodes from their positions [m] and normalised channels."""
        lifted, invariant = NodeEmbedding.lift(vectors, scalars, gravity)
        components = torch.cat([position.movedim(-1, 0) / self.length_scale, lifted.flatten(0, 1)])
        hidden, gate = self.to_scalars(torch.cat([components, invariant])).split(self.split, dim=-1)
        mixed = self.to_vectors(components).unflatten(-1, (3, -1)).movedim(-2, 0)
        return nn.functional.silu(hidden), mixed * (2.0 * torch.sigmoid(gate))
