"""Attention over all nodes without equivariance, a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.encoded_policy import EncodedPolicy, Features, HeadOptions, without_vectors
from maniskill_grpd.policies.layers import AttentionBlock, MergedNodes, RawDecoder, RawEmbedding


@dataclass(frozen=True, kw_only=True)
class TransformerOptions(HeadOptions):
    """Options of TransformerPolicy."""

    scalar_dim: int = 48
    """Channels of a node."""
    num_layers: int = 3
    """Attention blocks."""
    num_heads: int = 4
    """Attention heads; a divisor of scalar_dim."""
    hidden_dim: int = 144
    """Width of the second branch of a block."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scalar_dim % self.num_heads:
            raise ValueError(f"scalar_dim must be a multiple of num_heads ({self.num_heads}), got {self.scalar_dim}")

    @property
    def object_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of object nodes."""
        return self.scalar_dim, 0

    @property
    def actuator_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of actuators, the same."""
        return self.object_dims


class TransformerPolicy(EncodedPolicy):
    """Pre-norm transformer on the set of all nodes, one token per node.

    Tokens are made of raw coordinates, all channels and the node type; every node attends to every
    other, actuators and objects alike. Mesh edges are not used.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    name = "transformer"
    Options = TransformerOptions

    def make_encoder(self, schema: GraphSchema, options: TransformerOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return TransformerEncoder(schema, options)

    def make_mean(self, options: TransformerOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return RawDecoder(options.scalar_dim, bounded=options.magnitude == "sigmoid")


class TransformerEncoder(nn.Module):
    """Attention from a normalised graph to features of all nodes.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    def __init__(self, schema: GraphSchema, options: TransformerOptions) -> None:
        super().__init__()
        dim = options.scalar_dim
        self.merge = MergedNodes(schema)
        self.embed = RawEmbedding(self.merge.num_vectors, self.merge.num_scalars, dim, schema.length_scale)
        self.blocks = nn.ModuleList(
            AttentionBlock(dim, options.num_heads, options.hidden_dim, options.num_layers) for _ in range(options.num_layers)
        )
        self.norm = nn.LayerNorm(dim)

    def forward(self, graph: Mapping[str, Any]) -> tuple[Features, Features]:
        """Encode a graph.

        Args:
            graph: A normalised graph.

        Returns:
            (scalars (B, n, C), vectors (3, B, n, 0)) of object nodes and of actuators.
        """
        nodes = self.merge(graph)
        tokens = self.embed(nodes["position"], nodes["vectors"], nodes["scalars"], graph["gravity"])
        for block in self.blocks:
            tokens = block(tokens, nodes["mask"])
        tokens = self.norm(tokens)
        count = graph["object"]["position"].shape[1]
        return without_vectors(tokens[:, :count]), without_vectors(tokens[:, count:])
