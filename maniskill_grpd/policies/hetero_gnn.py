"""Heterogeneous graph network without equivariance, a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.encoded_policy import EncodedPolicy, Features, HeadOptions, without_vectors
from maniskill_grpd.policies.layers import MLPMessages, RawDecoder, RawEmbedding


@dataclass(frozen=True, kw_only=True)
class HeteroGNNOptions(HeadOptions):
    """Options of HeteroGNN."""

    scalar_dim: int = 48
    """Channels of an object node."""
    actuator_scalar_dim: int = 64
    """Channels of an actuator."""
    num_layers: int = 1
    """Rounds of object-object message passing (eq. 36, 37)."""

    @property
    def object_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of object nodes."""
        return self.scalar_dim, 0

    @property
    def actuator_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of actuators."""
        return self.actuator_scalar_dim, 0


class HeteroGNN(EncodedPolicy):
    """Graph network on heterogeneous graphs, without symmetry under rotations.

    Node types, edge types and message paths are those of GRPD (eq. 36-41). Messages are MLPs of
    both ends and of the raw relative position (eq. 24, 25), one per edge type; nodes know their raw
    coordinates.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    name = "hetero_gnn"
    Options = HeteroGNNOptions

    def make_encoder(self, schema: GraphSchema, options: HeteroGNNOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return HeteroGNNEncoder(schema, options)

    def make_mean(self, options: HeteroGNNOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return RawDecoder(options.actuator_scalar_dim, bounded=options.magnitude == "sigmoid")


class HeteroGNNEncoder(nn.Module):
    """Message passing from a normalised graph to features of all nodes (eq. 36-41).

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    def __init__(self, schema: GraphSchema, options: HeteroGNNOptions) -> None:
        super().__init__()
        width, tool_width, size = (options.scalar_dim, options.actuator_scalar_dim, schema.length_scale)
        self.embed_object = RawEmbedding(schema.object.num_vectors, schema.object.num_scalars, width, size)
        self.embed_actuator = RawEmbedding(schema.actuator.num_vectors, schema.actuator.num_scalars, tool_width, size)
        self.object_messages = nn.ModuleList(
            MLPMessages(width, width, width, width, schema.edge_length) for _ in range(options.num_layers)
        )
        self.object_updates = nn.ModuleList(_Update(width) for _ in range(options.num_layers))
        self.actuator_messages = MLPMessages(tool_width, tool_width, tool_width, tool_width, size)
        self.actuator_update = _Update(tool_width)
        self.global_messages = MLPMessages(width, tool_width, tool_width, tool_width, size)
        self.global_update = _Update(tool_width)

    def forward(self, graph: Mapping[str, Any]) -> tuple[Features, Features]:
        """Encode a graph.

        Args:
            graph: A normalised graph.

        Returns:
            (scalars (B, n, C), vectors (3, B, n, 0)) of object nodes and of actuators.
        """
        nodes, grippers, gravity = graph["object"], graph["actuator"], graph["gravity"]
        points, tools = nodes["position"], grippers["position"]
        objects = self.embed_object(points, nodes["vectors"], nodes["scalars"], gravity)
        for messages, update in zip(self.object_messages, self.object_updates, strict=True):
            sent = messages.neighbors(objects, points, nodes["mask"], nodes["neighbors"])
            objects = update(objects, sent)
        actuators = self.embed_actuator(tools, grippers["vectors"], grippers["scalars"], gravity)
        sent = self.actuator_messages.complete(actuators, actuators, tools, tools, grippers["mask"], exclude_self=True)
        actuators = self.actuator_update(actuators, sent)
        sent = self.global_messages.complete(objects, actuators, points, tools, nodes["mask"])
        return without_vectors(objects), without_vectors(self.global_update(actuators, sent))


class _Update(nn.Module):
    """Residual update h' = LayerNorm(h + W_2 silu(W_1 (h, m))) (eq. 3)."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.network = nn.Sequential(nn.Linear(2 * dim, dim), nn.SiLU(), nn.Linear(dim, dim))
        self.norm = nn.LayerNorm(dim)

    def forward(self, features: torch.Tensor, messages: torch.Tensor) -> torch.Tensor:
        return self.norm(features + self.network(torch.cat([features, messages], dim=-1)))
