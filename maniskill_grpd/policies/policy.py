"""What every policy offers."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from typing import Any, ClassVar

import torch
from torch import nn

from maniskill_grpd.graphs import GraphNormalizer, GraphSchema
from maniskill_grpd.policies.distribution import ActionDistribution


class Policy(nn.Module, abc.ABC):
    """A stochastic policy and its value function on observation graphs.

    All methods take raw graphs and scale them with `normalizer`, which whoever trains the policy
    updates. A subclass names itself and implements `evaluate`.

    Attributes:
        name: Name under which `make_policy` knows the class.
        schema: What the graphs hold.
        normalizer: Scales of the input channels; part of the state dict.
        config: Name, schema and options as plain types; `policy_from_config` rebuilds from it.

    Args:
        schema: What the graphs hold.
        options: Options of the subclass, plain types.
    """

    name: ClassVar[str]
    Options: ClassVar[type]

    def __init__(self, schema: GraphSchema, options: Mapping[str, Any]) -> None:
        super().__init__()
        self.schema = schema
        self.normalizer = GraphNormalizer(schema)
        self.config: dict[str, Any] = {"name": self.name, "schema": schema.to_dict(), "options": dict(options)}

    def prepare(self, graph: Mapping[str, Any]) -> dict[str, Any]:
        """Compute what depends on the observations and their scales, but not on any weight.

        Whoever evaluates the same graphs with changing weights does this once.

        Args:
            graph: Raw graphs.

        Returns:
            What `evaluate` takes, nested tensors (B, ...) of which graphs may be picked: here the normalised graphs.
        """
        self.schema.validate(graph)
        return self.normalizer(graph)

    @abc.abstractmethod
    def evaluate(
        self, graph: Mapping[str, Any], *, actor: bool, critic: bool
    ) -> tuple[ActionDistribution | None, torch.Tensor | None]:
        """Compute what is asked for of prepared graphs, in one shared pass.

        Args:
            graph: What `prepare` returned.
            actor: Whether the distribution is wanted.
            critic: Whether the value is wanted.

        Returns:
            Distribution and value (B,), each None if not asked for.
        """

    def forward(self, graph: Mapping[str, Any]) -> tuple[ActionDistribution, torch.Tensor]:
        """Distribution of actions and value (B,) of raw graphs."""
        return self._evaluate_raw(graph, actor=True, critic=True)

    def distribution(self, graph: Mapping[str, Any]) -> ActionDistribution:
        """Distribution of actions on raw graphs."""
        return self._evaluate_raw(graph, actor=True, critic=False)[0]

    def value(self, graph: Mapping[str, Any]) -> torch.Tensor:
        """Value (B,) of raw graphs."""
        return self._evaluate_raw(graph, actor=False, critic=True)[1]

    @abc.abstractmethod
    def rescale_value(self, factor: float, shift: float) -> None:
        """Change the value function so that every output v becomes factor * v + shift."""

    @torch.no_grad()
    def act(
        self, graph: Mapping[str, Any], deterministic: bool = False, generator: torch.Generator | None = None
    ) -> torch.Tensor:
        """Choose actions.

        Args:
            graph: Raw graphs.
            deterministic: Take the mean instead of a sample.
            generator: Source of randomness for samples.

        Returns:
            What `env.step` takes, float32: (B, A * 3), displacements in units of the largest one
            per step; with grippers (B, A * 4), each displacement followed by 1 to close and 0 to
            open. Not clipped: the controller limits the norm per actuator, a clip per axis would
            break equivariance.
        """
        distribution = self.distribution(graph)
        action = distribution.mode if deterministic else distribution.sample(generator)
        return action.float()

    def _evaluate_raw(self, graph: Mapping[str, Any], *, actor: bool, critic: bool) -> tuple[Any, Any]:
        return self.evaluate(self.prepare(graph), actor=actor, critic=critic)
