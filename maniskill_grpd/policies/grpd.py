"""Graph-Reinforced Policy for Deformables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.encoded_policy import EncodedPolicy, Features, HeadOptions, equivariant_mean
from maniskill_grpd.policies.layers import EdgeGeometry, NodeEmbedding, RawNodeEmbedding, edges_from_tensors, edges_to_tensors
from maniskill_grpd.policies.message_round import MessageRound
from maniskill_grpd.policies.shared_encoder import SharedEncoder


@dataclass(frozen=True, kw_only=True)
class GRPDOptions(HeadOptions):
    """Options of GRPD."""

    scalar_dim: int = 32
    """Scalar channels of an object node."""
    vector_dim: int = 16
    """Vector channels of an object node."""
    actuator_scalar_dim: int = 52
    """Scalar channels of an actuator; there are few actuators, so width is cheap."""
    actuator_vector_dim: int = 16
    """Vector channels of an actuator."""
    num_layers: int = 1
    """Rounds of object-object message passing (eq. 36, 37)."""
    num_radial: int = 6
    """Radial functions of the edges from objects to actuators."""
    num_actuator_radial: int = 3
    """Radial functions of the edges between actuators."""
    num_local_radial: int = 1
    """Radial functions of mesh edges; more pay only if neighbours are at different distances."""
    max_degree: int = 1
    """Largest degree of the harmonics from objects to actuators, 1 or 2."""
    max_local_degree: int = 1
    """Largest degree of the harmonics along mesh edges, 1 or 2."""
    receiver_gates: bool = True
    """Whether messages depend on their receiver (eq. 36, 38, 40)."""
    normalize_vectors: bool = False
    """Whether vector features are normalised after each round; for many rounds."""
    decoder: Literal["direction_magnitude", "naive"] = "direction_magnitude"
    """Mean action as direction times magnitude (eq. 51, 52) or as one vector (eq. 50)."""
    coordinates: Literal["relative", "raw"] = "relative"
    """What the first layer of a node sees: raw coordinates are an ablation, without symmetry."""
    weights: Literal["typed", "shared"] = "typed"
    """Whether node and edge types have weights of their own; shared ones are an ablation."""
    shared_scalar_dim: int = 64
    """Scalar channels of all nodes with shared weights; the default has as many parameters as typed weights have."""
    object_messages: bool = True
    """Whether actuators hear the objects (eq. 40); without, they act blindly: an ablation."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("max_degree", "max_local_degree"):
            if getattr(self, name) not in (1, 2):
                raise ValueError(f"{name} must be 1 or 2, got {getattr(self, name)}")
        if self.coordinates == "raw" and self.weights == "shared":
            raise ValueError("coordinates='raw' and weights='shared' are two ablations; choose one")

    @property
    def object_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of object nodes."""
        return self.actuator_dims if self.weights == "shared" else (self.scalar_dim, self.vector_dim)

    @property
    def actuator_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of actuators."""
        scalar_dim = self.shared_scalar_dim if self.weights == "shared" else self.actuator_scalar_dim
        return scalar_dim, self.actuator_vector_dim


class GRPD(EncodedPolicy):
    """SE(3)-equivariant policy on heterogeneous graphs.

    An encoder passes messages between object nodes (eq. 36, 37), between actuators (38, 39) and
    from all object nodes to every actuator (40, 41), each with weights of its own. Actuator
    features are decoded to direction times magnitude with isotropic noise (48-54); a DeepSets
    function of all node features gives the value (8).

    Rotating, translating the scene, and gravity with it, rotates the mean action and leaves
    standard deviation and value alone, to rounding. Any number of nodes and actuators is accepted.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    name = "grpd"
    Options = GRPDOptions

    def make_encoder(self, schema: GraphSchema, options: GRPDOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return SharedEncoder(schema, options) if options.weights == "shared" else GRPDEncoder(schema, options)

    def prepare(self, graph: Mapping[str, Any]) -> dict[str, Any]:
        """See `Policy.prepare`."""
        scaled = super().prepare(graph)
        if not isinstance(self.encoder, GRPDEncoder):
            return scaled
        prepared = self.encoder.prepare(scaled)
        if "critic" in scaled:
            prepared["critic"] = self.encoder.prepare(scaled["critic"])
        return prepared

    def make_mean(self, options: GRPDOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return equivariant_mean(options)


class GRPDEncoder(nn.Module):
    """Message passing from a prepared graph to features of all nodes (eq. 36-41).

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    def __init__(self, schema: GraphSchema, options: GRPDOptions) -> None:
        super().__init__()
        dims, tool_dims = options.object_dims, options.actuator_dims
        edge, size = schema.edge_length, schema.length_scale
        self.has_raw_coordinates = options.coordinates == "raw"
        self.embed_object, self.embed_actuator = (
            RawNodeEmbedding(node.num_vectors, node.num_scalars, *node_dims, size)
            if self.has_raw_coordinates
            else NodeEmbedding(node.num_vectors, node.num_scalars, *node_dims)
            for node, node_dims in ((schema.object, dims), (schema.actuator, tool_dims))
        )
        local = options.num_local_radial, options.max_local_degree
        between = options.num_actuator_radial, 1
        across = options.num_radial, options.max_degree
        self.local_geometry = EdgeGeometry(*local, edge, 0.5 * edge)
        self.actuator_geometry = EdgeGeometry(*between, size, 0.05 * size)
        self.global_geometry = EdgeGeometry(*across, size, 0.05 * size)
        variants = {"receiver_gates": options.receiver_gates, "normalize_vectors": options.normalize_vectors}
        self.object_rounds = nn.ModuleList(MessageRound(dims, dims, *local, **variants) for _ in range(options.num_layers))
        self.actuator_round = MessageRound(tool_dims, tool_dims, *between, **variants)
        self.global_round = MessageRound(dims, tool_dims, *across, **variants) if options.object_messages else None

    def forward(self, graph: Mapping[str, Any]) -> tuple[Features, Features]:
        """Encode a graph.

        Args:
            graph: What `prepare` returned.

        Returns:
            (scalars (B, n, C), vectors (3, B, n, D)) of object nodes and of actuators.
        """
        edges = graph["edges"]
        objects = self._embed(self.embed_object, graph["object"])
        if len(self.object_rounds):
            local = edges_from_tensors(edges["local"], self.local_geometry.basis.num_basis)
            for message_round in self.object_rounds:
                objects = message_round(objects, objects, local)
        actuators = self._embed(self.embed_actuator, graph["actuator"])
        between = edges_from_tensors(edges["between"], self.actuator_geometry.basis.num_basis)
        actuators = self.actuator_round(actuators, actuators, between)
        if self.global_round is not None:
            across = edges_from_tensors(edges["across"], self.global_geometry.basis.num_basis)
            actuators = self.global_round(objects, actuators, across)
        return objects, actuators

    def prepare(self, graph: Mapping[str, Any]) -> dict[str, Any]:
        """Compute what needs no weights: inputs in all their forms, and kernel factors of all edges.

        Args:
            graph: A normalised graph.

        Returns:
            What `forward` takes; nested tensors (B, ...).
        """
        nodes, grippers = graph["object"], graph["actuator"]
        # Component first, like all vectors inside the network.
        points, tools = (kind["position"].movedim(-1, 0).contiguous() for kind in (nodes, grippers))
        edges = {"between": self.actuator_geometry.complete(tools, grippers["mask"], tools, exclude_self=True)}
        if len(self.object_rounds):
            edges["local"] = self.local_geometry.neighbors(points, nodes["mask"], nodes["neighbors"])
        if self.global_round is not None:
            edges["across"] = self.global_geometry.complete(points, nodes["mask"], tools)
        return {
            "object": self._inputs(nodes, graph["gravity"]),
            "actuator": self._inputs(grippers, graph["gravity"]),
            "edges": {name: edges_to_tensors(kind) for name, kind in edges.items()},
        }

    def _inputs(self, nodes: Mapping[str, torch.Tensor], gravity: torch.Tensor) -> dict[str, torch.Tensor]:
        """What the embedding takes of the nodes of one type, and their mask."""
        if self.has_raw_coordinates:
            kept = {key: nodes[key] for key in ("mask", "position", "vectors", "scalars")}
            return {**kept, "gravity": gravity}
        lifted, invariants = NodeEmbedding.lift_graphs(nodes["vectors"], nodes["scalars"], gravity)
        return {"mask": nodes["mask"], "lifted": lifted, "invariants": invariants}

    def _embed(self, embedding: nn.Module, inputs: Mapping[str, torch.Tensor]) -> Features:
        """First features of the nodes of one type."""
        if self.has_raw_coordinates:
            return embedding(*(inputs[key] for key in ("position", "vectors", "scalars", "gravity")))
        return embedding.embed(inputs["lifted"], inputs["invariants"])
