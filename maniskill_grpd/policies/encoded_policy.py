"""What the policies have in common: an encoder, heads at the actuators, a value function."""

from __future__ import annotations

import abc
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Literal

import torch
from torch import nn

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.graphs.schema import NODE_TYPES
from maniskill_grpd.policies.distribution import ActionDistribution
from maniskill_grpd.policies.layers import (
    DeepSetsValue,
    DirectionMagnitudeDecoder,
    GripperHead,
    InvariantStd,
    NaiveDecoder,
    PerActuator,
)
from maniskill_grpd.policies.policy import Policy

Features = tuple[torch.Tensor, torch.Tensor]
"""Scalars (B, n, C) and vectors (3, B, n, D) of one node type; D is 0 without equivariance."""


@dataclass(frozen=True, kw_only=True)
class HeadOptions(abc.ABC):
    """Options of all policies."""

    init_std: float = 0.5
    """Standard deviation before training, in units of the largest action."""
    state_dependent_std: bool = True
    """False: one learned standard deviation for all states and actuators."""
    noise: Literal["isotropic", "directed"] = "isotropic"
    """Noise of actions: the same in all directions, or with a deviation along the mean and one across it, so that
    length and direction are explored each to its own extent."""
    value_dim: int = 64
    """Width of the value function after the sum over nodes; before it, scalar_dim."""
    value_encoder: Literal["shared", "separate"] = "shared"
    """Whether the value function reads the actor's node features or has an encoder of its own."""
    magnitude: Literal["sigmoid", "softplus", "relu"] = "sigmoid"
    """Activation of the mean action's length: sigmoid keeps it below 1.2, softplus does not bound it, relu is
    eq. 52 as printed. Decoders without a magnitude of their own bound the norm with sigmoid alone."""
    decoders: Literal["shared", "independent"] = "shared"
    """Independent: weights of its own for each place in the list of actuators. The order of
    actuators then matters, and no graph may have more than num_decoders of them."""
    num_decoders: int = 4
    """Number of independent decoders."""
    gripper: bool = False
    """Whether actions have a fourth entry per actuator that closes (1) or opens (0) it."""

    def __post_init__(self) -> None:
        for name in (field.name for field in fields(self)):
            if name.endswith(("_dim", "_radial", "_heads", "_decoders", "_nearest")):
                if getattr(self, name) < 1:
                    raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
            elif name == "num_layers" and self.num_layers < 0:
                raise ValueError(f"num_layers must not be negative, got {self.num_layers}")

    @property
    @abc.abstractmethod
    def object_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of object nodes."""

    @property
    @abc.abstractmethod
    def actuator_dims(self) -> tuple[int, int]:
        """Scalar and vector channels of actuators."""


class EncodedPolicy(Policy):
    """Encoder, decoder of mean actions, standard deviation, gripper, DeepSets value.

    A subclass builds its encoder, a module from a normalised graph to `Features` of objects and of
    actuators, and its decoder of mean actions.

    Args:
        schema: What the graphs hold.
        options: Sizes and variants.
    """

    Options: type[HeadOptions]

    def __init__(self, schema: GraphSchema, options: HeadOptions) -> None:
        super().__init__(schema, asdict(options))
        dims = (options.object_dims, options.actuator_dims)

        def head(make: Callable[[], nn.Module]) -> nn.Module:
            independent = options.decoders == "independent"
            return PerActuator(make, options.num_decoders) if independent else make()

        num_axes = 2 if options.noise == "directed" else 1
        self.encoder = self.make_encoder(schema, options)
        self.mean = head(lambda: self.make_mean(options))
        self.std = head(lambda: InvariantStd(*dims[1], options.init_std, options.state_dependent_std, num_axes))
        self.value_encoder: nn.Module | None = None
        if options.value_encoder == "separate":
            self.value_encoder = self.make_encoder(schema, options)
        self.critic = DeepSetsValue(dims, dims[0][0], options.value_dim)
        self.gripper = head(lambda: GripperHead(*dims[1])) if options.gripper else None

    @abc.abstractmethod
    def make_encoder(self, schema: GraphSchema, options: Any) -> nn.Module:
        """Build an encoder with fresh weights."""

    @abc.abstractmethod
    def make_mean(self, options: Any) -> nn.Module:
        """Build a decoder from actuator features to mean actions (..., 3)."""

    def evaluate(
        self, graph: Mapping[str, Any], *, actor: bool, critic: bool
    ) -> tuple[ActionDistribution | None, torch.Tensor | None]:
        """See `Policy.evaluate`."""
        seen_by_critic = graph.get("critic", graph)
        shares_nodes = self.value_encoder is None and seen_by_critic is graph
        distribution = value = nodes = None
        if actor or shares_nodes:
            nodes = self.encoder(graph)
        if actor:
            distribution = self._decode(nodes[1], graph["actuator"]["mask"])
        if critic:
            if not shares_nodes:
                nodes = (self.value_encoder or self.encoder)(seen_by_critic)
            masks = (seen_by_critic[kind]["mask"] for kind in NODE_TYPES)
            value = self.critic([(*node, mask) for node, mask in zip(nodes, masks, strict=True)])
        return distribution, value

    def rescale_value(self, factor: float, shift: float) -> None:
        """See `Policy.rescale_value`."""
        self.critic.rescale(factor, shift)

    def _decode(self, actuators: Features, mask: torch.Tensor) -> ActionDistribution:
        mean = self.mean(*actuators).masked_fill(~mask[..., None], 0.0)
        logits = None if self.gripper is None else self.gripper(*actuators).squeeze(-1)
        return ActionDistribution(mean, self.std(*actuators), mask, logits)


def equivariant_mean(options: Any) -> nn.Module:
    """Decoder of mean actions that `options.decoder` names."""
    dims = options.actuator_dims
    if options.decoder == "naive":
        return NaiveDecoder(*dims, bounded=options.magnitude == "sigmoid")
    return DirectionMagnitudeDecoder(*dims, options.magnitude)


def without_vectors(scalars: torch.Tensor) -> Features:
    """Features of policies that know scalars only."""
    return scalars, scalars.new_zeros(3, *scalars.shape[:-1], 0)
