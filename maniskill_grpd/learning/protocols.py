"""What training asks of environments and policies."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol

import torch

from maniskill_grpd.graphs import GraphNormalizer, GraphSchema
from maniskill_grpd.policies import ActionDistribution


class Progress(Protocol):
    """The number in `info` that tells how near a task is to being done."""

    @property
    def name(self) -> str:
        """Its key in `info`."""

    @property
    def unit(self) -> str:
        """Its unit, empty if it has none."""


class Task(Protocol):
    """The environment inside all wrappers."""

    PROGRESS: Progress
    num_envs: int


class GraphVecEnv(Protocol):
    """B environments that are stepped together and observe graphs, such as a ManiSkillVectorEnv on `obs_mode="graph"`.

    In training an environment resets itself in the step that ends its episode; `info` then holds `final_observation`,
    `final_info` with the means of the episode under `episode`, and `_final_info`, bool (B,): whose episode ended.
    """

    num_envs: int

    @property
    def unwrapped(self) -> Task:
        """The task itself."""

    def reset(self, *, seed: Sequence[int]) -> tuple[dict[str, Any], dict[str, Any]]:
        """Start an episode in every environment, that of row i from seed[i] alone; returns observation and info.

        The observation holds nested tensors (B, ...) under "graph".
        """

    def step(self, action: torch.Tensor) -> tuple[dict[str, Any], torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Take actions (B, A * E); returns observation, reward (B,), terminated and truncated, bool (B,), and info."""


class ActorCritic(Protocol):
    """A policy with its value function, a torch module on raw observation graphs; `policies.Policy` is one.

    Attributes:
        schema: What the graphs hold.
        normalizer: Scales of the observations, which whoever trains updates.
        config: What rebuilds the policy, plain types.
    """

    schema: GraphSchema
    normalizer: GraphNormalizer
    config: dict[str, Any]

    def __call__(self, graph: Mapping[str, Any]) -> tuple[ActionDistribution, torch.Tensor]:
        """Return the distribution of actions and the value output (B,)."""

    def prepare(self, graph: Mapping[str, Any]) -> dict[str, Any]:
        """Return what can be computed of graphs before any weight is used, nested tensors (B, ...)."""

    def evaluate(
        self, graph: Mapping[str, Any], *, actor: bool, critic: bool
    ) -> tuple[ActionDistribution | None, torch.Tensor | None]:
        """Return distribution and value output of prepared graphs, each None if not asked for."""

    def value(self, graph: Mapping[str, Any]) -> torch.Tensor:
        """Return the value output alone, (B,)."""

    def rescale_value(self, factor: float, shift: float) -> None:
        """Change the value function so that every output v becomes factor * v + shift."""

    def act(
        self, graph: Mapping[str, Any], deterministic: bool = False, generator: torch.Generator | None = None
    ) -> torch.Tensor:
        """Return actions (B, A * E)."""

    def parameters(self) -> Iterator[torch.nn.Parameter]:
        """Yield the weights."""

    def named_parameters(self) -> Iterator[tuple[str, torch.nn.Parameter]]:
        """Yield the weights with their names."""

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Return weights and statistics."""

    def load_state_dict(self, state_dict: Mapping[str, torch.Tensor]) -> Any:
        """Restore what `state_dict` returned."""
