"""GRPD's encoder with one set of weights for all types of nodes and edges: heterogeneity off, and nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.encoded_policy import Features
from maniskill_grpd.policies.layers import EdgeGeometry, MergedNodes, NodeEmbedding
from maniskill_grpd.policies.message_round import MessageRound


class SharedEncoder(nn.Module):
    """The messages of `GRPDEncoder`, along the same edges in the same order, by one network (A.C.7).

    Nodes of both types have the channels of both, zeros where one lacks a channel, tell their type and are equally wide. One
    embedding, and one convolution and update (several, with several rounds between objects, of which the first also serves
    actuators), see every node and edge. Kernels have as many radial functions as those from objects to actuators.

    Symmetry: as `GRPDEncoder`.

    Args:
        schema: What the graphs hold.
        options: Options of GRPD.
    """

    def __init__(self, schema: GraphSchema, options: Any) -> None:
        super().__init__()
        dims, kernel = options.actuator_dims, (options.num_radial, options.max_degree)
        edge, size = schema.edge_length, schema.length_scale
        self.num_layers = options.num_layers
        self.has_object_messages = options.object_messages
        self.merge = MergedNodes(schema)
        self.embed = NodeEmbedding(self.merge.num_vectors, self.merge.num_scalars, *dims)
        self.local_geometry = EdgeGeometry(*kernel, edge, 0.5 * edge)
        self.long_geometry = EdgeGeometry(*kernel, size, 0.05 * size)
        self.rounds = nn.ModuleList(
            MessageRound(dims, dims, *kernel, receiver_gates=options.receiver_gates, normalize_vectors=options.normalize_vectors)
            for _ in range(max(1, options.num_layers))
        )

    def forward(self, graph: Mapping[str, Any]) -> tuple[Features, Features]:
        """Encode a graph; see `GRPDEncoder.forward`."""
        nodes, neighbors = self.merge(graph), graph["object"]["neighbors"]
        count = neighbors.shape[1]
        points, tools = _split(nodes["position"].movedim(-1, 0).contiguous(), count)
        point_mask, tool_mask = nodes["mask"][:, :count], nodes["mask"][:, count:]
        scalars, vectors = self.embed(nodes["vectors"], nodes["scalars"], graph["gravity"])
        (object_scalars, tool_scalars), (object_vectors, tool_vectors) = _split(scalars[None], count), _split(vectors, count)
        objects, actuators = (object_scalars[0], object_vectors), (tool_scalars[0], tool_vectors)
        if self.num_layers:
            edges = self.local_geometry.neighbors(points, point_mask, neighbors)
            for message_round in self.rounds:
                objects = message_round(objects, objects, edges)
        first = self.rounds[0]
        actuators = first(actuators, actuators, self.long_geometry.complete(tools, tool_mask, tools, exclude_self=True))
        if self.has_object_messages:
            actuators = first(objects, actuators, self.long_geometry.complete(points, point_mask, tools))
        return objects, actuators


def _split(values: torch.Tensor, count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Split (M, B, N + A, ...) into objects and actuators."""
    return values[:, :, :count].contiguous(), values[:, :, count:].contiguous()
