"""Equivariant message passing on a homogeneous graph, a baseline."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.encoded_policy import EncodedPolicy, Features, HeadOptions, equivariant_mean
from maniskill_grpd.policies.layers import (
    CompleteEdges,
    EdgeGeometry,
    EquivariantUpdate,
    LocalNeighborhood,
    MergedNodes,
    NeighborEdges,
    NodeEmbedding,
    SteerableConv,
)

Edges = CompleteEdges | NeighborEdges


@dataclass(frozen=True, kw_only=True)
class EMPNOptions(HeadOptions):
    """Options of EMPN."""

    scalar_dim: int = 48
    """Scalar channels of a node."""
    vector_dim: int = 20
    """Vector channels of a node."""
    num_layers: int = 3
    """Rounds of message passing; they limit how far an actuator sees (eq. 46)."""
    num_radial: int = 2
    """Radial functions of the edges."""
    max_degree: int = 1
    """Largest degree of the harmonics, 1 or 2."""
    receiver_gates: bool = True
    """Whether messages depend on their receiver, as those of GRPD."""
    normalize_vectors: bool = False
    """Whether vector features are normalised after each round; for many rounds."""
    num_nearest: int = 8
    """Object nodes that each actuator is connected with."""
    decoder: Literal["direction_magnitude", "naive"] = "direction_magnitude"
    """Mean action as direction times magnitude (eq. 51, 52) or as one vector (eq. 50)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.max_degree not in (1, 2):
            raise ValueError(f"max_degree must be 1 or 2, got {self.max_degree}")

    @property
    def object_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of object nodes."""
        return self.scalar_dim, self.vector_dim

    @property
    def actuator_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of actuators, the same."""
        return self.object_dims


class EMPN(EncodedPolicy):
    """SE(3)-equivariant message passing network on a homogeneous graph.

    The layers are those of GRPD, with one node type and one edge type (eq. 32): all nodes have the
    same weights, and messages flow along mesh edges, between actuators and between actuators and
    the object nodes nearest to them. What lies more than `num_layers` edges away from all actuators
    has no influence on the action (eq. 46).

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    name = "empn"
    Options = EMPNOptions

    def make_encoder(self, schema: GraphSchema, options: EMPNOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return EMPNEncoder(schema, options)

    def make_mean(self, options: EMPNOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return equivariant_mean(options)


class EMPNEncoder(nn.Module):
    """Message passing from a normalised graph to features of all nodes (eq. 32).

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    def __init__(self, schema: GraphSchema, options: EMPNOptions) -> None:
        super().__init__()
        dims = options.object_dims
        self.num_nearest = options.num_nearest
        self.merge = MergedNodes(schema)
        self.embed = NodeEmbedding(self.merge.num_vectors, self.merge.num_scalars, *dims)
        # Edges range from the spacing of the mesh to the distance between actuators: distances are
        # resolved at the scale of the object, directions at that of the mesh.
        self.geometry = EdgeGeometry(options.num_radial, options.max_degree, 0.5 * schema.length_scale, 0.5 * schema.edge_length)
        self.rounds = nn.ModuleList(_HomogeneousRound(dims, options) for _ in range(options.num_layers))

    def forward(self, graph: Mapping[str, Any]) -> tuple[Features, Features]:
        """Encode a graph.

        Args:
            graph: A normalised graph.

        Returns:
            (scalars (B, n, C), vectors (3, B, n, D)) of object nodes and of actuators.
        """
        nodes = self.merge(graph)
        count = graph["object"]["position"].shape[1]
        edges = self._connect(nodes, graph["object"]["neighbors"])
        features = self.embed(nodes["vectors"], nodes["scalars"], graph["gravity"])
        for message_round in self.rounds:
            features = message_round(features, edges, count)
        return _split_nodes(*features, count)

    def _connect(self, nodes: Mapping[str, torch.Tensor], neighbors: torch.Tensor) -> tuple[Edges, Edges]:
        """Edges to objects and to actuators; lists of different length, otherwise alike."""
        local = LocalNeighborhood.find(nodes["position"], nodes["mask"], neighbors, self.num_nearest)
        points = nodes["position"].movedim(-1, 0).contiguous()
        count = neighbors.shape[1]
        return tuple(
            self.geometry.neighbors(points, nodes["mask"], senders, receivers=receivers.contiguous(), envelope=envelope)
            for senders, envelope, receivers in (
                (local.objects, local.object_envelope, points[:, :, :count]),
                (local.actuators, local.actuator_envelope, points[:, :, count:]),
            )
        )


class _HomogeneousRound(nn.Module):
    """One convolution and one update, the same for all edges and all nodes (eq. 32)."""

    def __init__(self, dims: tuple[int, int], options: EMPNOptions) -> None:
        super().__init__()
        receiver_dims = dims if options.receiver_gates else None
        self.conv = SteerableConv(
            *dims, num_radial=options.num_radial, max_degree=options.max_degree, receiver_dims=receiver_dims
        )
        self.update = EquivariantUpdate(*dims, message_dim=dims[0], normalize_vectors=options.normalize_vectors)

    def forward(self, features: Features, edges: tuple[Edges, Edges], count: int) -> Features:
        """Update all nodes, of which the first `count` are objects."""
        nodes = _split_nodes(*features, count)
        sent = (self.conv(*features, part, receivers) for part, receivers in zip(edges, nodes, strict=True))
        scalars, vectors = zip(*sent, strict=True)
        return self.update(*features, torch.cat(scalars, dim=1), torch.cat(vectors, dim=2))


def _split_nodes(scalars: torch.Tensor, vectors: torch.Tensor, count: int) -> tuple[Features, Features]:
    """Features of the first `count` nodes, the objects, and of the others."""
    return (scalars[:, :count], vectors[:, :, :count]), (scalars[:, count:], vectors[:, :, count:])
