"""Heterogeneous equivariant policy on a grid of directions, a published neighbour of GRPD."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.policies.encoded_policy import EncodedPolicy, Features, HeadOptions, equivariant_mean
from maniskill_grpd.policies.layers import NodeEmbedding, OrientationRound, orientation_grid


@dataclass(frozen=True, kw_only=True)
class HEPiOptions(HeadOptions):
    """Options of HEPi."""

    scalar_dim: int = 52
    """Channels of a node in each direction."""
    vector_dim: int = 16
    """Vectors that are read off the directions of a node."""
    kernel_dim: int = 32
    """Width of the kernels."""
    num_layers: int = 1
    """Rounds of messages between objects."""
    num_directions: int = 16
    """Directions of the grid, a multiple of 4."""
    decoder: Literal["direction_magnitude", "naive"] = "direction_magnitude"
    """Mean action as direction times magnitude (eq. 51, 52) or as one vector (eq. 50)."""

    @property
    def object_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of object nodes."""
        return self.scalar_dim, self.vector_dim

    @property
    def actuator_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of actuators, the same."""
        return self.object_dims


class HEPi(EncodedPolicy):
    """Heterogeneous Equivariant Policy, written from its description (Hoang et al., ICLR 2025, arXiv:2502.07005).

    Features of a node are functions on a grid of 16 directions, and messages convolve over positions and directions, as in the
    networks that it is built from (Bekkers et al., ICLR 2024). Types of nodes and edges have weights of their own: messages
    between neighbours of the object, between actuators, and from all of the object to every actuator, in this order. Inputs,
    decoders, noise and value function are those of GRPD.

    Symmetry: translations exactly; rotations that map the grid onto itself (quarter turns about z) exactly, others to the
    accuracy of the grid.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    name = "hepi"
    Options = HEPiOptions

    def make_encoder(self, schema: GraphSchema, options: HEPiOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return HEPiEncoder(schema, options)

    def make_mean(self, options: HEPiOptions) -> nn.Module:
        """See `EncodedPolicy`."""
        return equivariant_mean(options)


class HEPiEncoder(nn.Module):
    """Message passing from a normalised graph to features of all nodes.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    def __init__(self, schema: GraphSchema, options: HEPiOptions) -> None:
        super().__init__()
        dim, kernel = options.scalar_dim, options.kernel_dim
        directions = orientation_grid(options.num_directions)
        self.register_buffer("directions", directions, persistent=False)
        self.embed_object = _Lift(schema.object.num_vectors, schema.object.num_scalars, dim)
        self.embed_actuator = _Lift(schema.actuator.num_vectors, schema.actuator.num_scalars, dim)
        edge, size = schema.edge_length, schema.length_scale
        self.object_rounds = nn.ModuleList(
            OrientationRound(dim, dim, kernel, edge, directions) for _ in range(options.num_layers)
        )
        self.actuator_round = OrientationRound(dim, dim, kernel, size, directions)
        self.global_round = OrientationRound(dim, dim, kernel, size, directions)
        self.read_object = nn.Linear(dim, options.vector_dim, bias=False)
        self.read_actuator = nn.Linear(dim, options.vector_dim, bias=False)

    def forward(self, graph: Mapping[str, Any]) -> tuple[Features, Features]:
        """Encode a graph.

        Args:
            graph: A normalised graph.

        Returns:
            (scalars (B, n, C), vectors (3, B, n, D)) of object nodes and of actuators.
        """
        nodes, grippers, gravity = graph["object"], graph["actuator"], graph["gravity"]
        points, tools = nodes["position"], grippers["position"]
        objects = self.embed_object(nodes["vectors"], nodes["scalars"], gravity, self.directions)
        for message_round in self.object_rounds:
            objects = message_round.neighbors(objects, points, nodes["mask"], nodes["neighbors"])
        actuators = self.embed_actuator(grippers["vectors"], grippers["scalars"], gravity, self.directions)
        actuators = self.actuator_round.complete(actuators, actuators, tools, tools, grippers["mask"], exclude_self=True)
        actuators = self.global_round.complete(objects, actuators, points, tools, nodes["mask"])
        return self._read(objects, self.read_object), self._read(actuators, self.read_actuator)

    def _read(self, features: torch.Tensor, weights: nn.Module) -> Features:
        """Means over directions, and means of directions weighted by features (B, n, O, C)."""
        count = len(self.directions)
        # The mean of o o^T over the sphere is a third of the identity.
        vectors = torch.einsum("bnod,oi->ibnd", weights(features), self.directions) * (3.0 / count)
        return features.mean(2), vectors


class _Lift(nn.Module):
    """Features of a node in each direction: its invariants, and the components of its vectors along the direction."""

    def __init__(self, num_vectors: int, num_scalars: int, dim: int) -> None:
        super().__init__()
        num_lifted, num_invariants = NodeEmbedding.lifted_dims(num_vectors, num_scalars)
        self.along = nn.Linear(num_lifted, dim, bias=False)
        self.invariant = nn.Linear(num_invariants, dim)

    def forward(
        self, vectors: torch.Tensor, scalars: torch.Tensor, gravity: torch.Tensor, directions: torch.Tensor
    ) -> torch.Tensor:
        """(B, n, O, C) from normalised channels, gravity (B, 3) and the grid (O, 3)."""
        lifted, invariant = NodeEmbedding.lift(vectors, scalars, gravity)
        components = torch.einsum("libn,oi->bnol", lifted, directions)
        return nn.functional.silu(self.along(components) + self.invariant(invariant.permute(1, 2, 0))[:, :, None])
