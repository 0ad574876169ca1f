"""Storage of one rollout: T steps of B environments, with whole observation graphs."""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch

from maniskill_grpd.policies import ActionDistribution

Graph = dict[str, Any]
"""A nested dictionary of tensors that share their leading dimensions."""


def map_graph(function: Callable[[torch.Tensor], torch.Tensor], graph: Graph) -> Graph:
    """Apply a function to every tensor of a nested dictionary; None stays None."""

    def apply(value: Any) -> Any:
        if isinstance(value, dict):
            return map_graph(function, value)
        return None if value is None else function(value)

    return {key: apply(value) for key, value in graph.items()}


def cat_graphs(graphs: Sequence[Graph]) -> Graph:
    """Join nested dictionaries of tensors along their first dimension."""

    def join(values: list[Any]) -> Any:
        if values[0] is None:
            return None
        return cat_graphs(values) if isinstance(values[0], dict) else torch.cat(values)

    return {key: join([graph[key] for graph in graphs]) for key in graphs[0]}


def graph_items(graph: Graph, prefix: str = "") -> Iterator[tuple[str, torch.Tensor]]:
    """Yield the tensors of a nested dictionary with dotted names, such as "object.position"."""
    for key, value in graph.items():
        if isinstance(value, dict):
            yield from graph_items(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


@dataclass(frozen=True, kw_only=True)
class Batch:
    """M transitions as the losses see them. The old policy is the one that collected the rollout."""

    graph: Graph
    """Observation graphs, leading dimension M: raw, or what `Policy.prepare` made of them."""
    is_prepared: bool = False
    """Whether the graphs are prepared."""
    actions: torch.Tensor
    """Actions that were taken, (M, A * 3), or (M, A * 4) with grippers."""
    log_probs: torch.Tensor
    """Log probabilities of the actions under the old policy, (M,)."""
    old: ActionDistribution
    """The old policy at the observations, leading dimension M."""
    advantages: torch.Tensor
    """Advantages, normalised if so configured, (M,)."""
    returns: torch.Tensor
    """Value targets in the units of the rewards, (M,)."""

    def __len__(self) -> int:
        """Number M of transitions."""
        return self.actions.shape[0]

    def split(self, size: int) -> list[Batch]:
        """Split into batches of nearly equal size, at most `size`, as views."""
        count = -(-len(self) // size)
        if count == 1:
            return [self]
        edges = [len(self) * i // count for i in range(count + 1)]
        return [self._slice(start, end) for start, end in zip(edges, edges[1:], strict=False)]

    def select(self, index: torch.Tensor) -> Batch:
        """Gather some of the transitions, int64 positions (m,)."""
        return self.map(lambda tensor: tensor.index_select(0, index))

    def _slice(self, start: int, end: int) -> Batch:
        return self.map(lambda tensor: tensor[start:end])

    def map(self, function: Callable[[torch.Tensor], torch.Tensor]) -> Batch:
        """Apply a function to every tensor, those of the graph included."""
        return Batch(
            graph=map_graph(function, self.graph),
            is_prepared=self.is_prepared,
            actions=function(self.actions),
            log_probs=function(self.log_probs),
            old=self.old.map(function),
            advantages=function(self.advantages),
            returns=function(self.returns),
        )


class Rollout:
    """Preallocated time-major storage, (T, B, ...) per tensor; nothing is allocated while collecting.

    Args:
        num_steps: T.
        graph: An observation graph of the environments, (B, ...) per tensor: gives shapes and device.
        dist: The policy there: gives the shapes of what it decides.
    """

    def __init__(self, num_steps: int, graph: Graph, dist: ActionDistribution) -> None:
        def like(tensor: torch.Tensor) -> torch.Tensor:
            return tensor.new_empty((num_steps, *tensor.shape))

        num_envs = dist.mean.shape[0]
        scalars = dist.mean.new_zeros(num_envs)
        self.num_steps = num_steps
        self.num_envs = num_envs
        self.graph = map_graph(like, graph)
        self.is_prepared = False
        self.actions = like(dist.mode)
        self.distribution = dist.map(like)
        self.log_probs, self.rewards, self.values = like(scalars), like(scalars), like(scalars)
        self.final_values = scalars.new_zeros((num_steps, num_envs))
        self.terminated, self.truncated = like(scalars.bool()), like(scalars.bool())
        self.next_value = scalars.clone()
        self.advantages, self.returns = like(scalars), like(scalars)

    def store_graph(self, step: int, graph: Graph) -> None:
        """Copy the observation graphs of one step, (B, ...) per tensor.

        Raises:
            ValueError: If a tensor is missing or has changed its shape since the first observation.
        """
        given = dict(graph_items(graph))
        for name, storage in graph_items(self.graph):
            if name not in given or given[name].shape != storage.shape[1:]:
                found = tuple(given[name].shape) if name in given else "nothing"
                raise ValueError(f"observation graph: {name} must stay {tuple(storage.shape[1:])}, got {found}")
            storage[step].copy_(given[name])

    def store_decision(self, step: int, dist: ActionDistribution, action: torch.Tensor, log_prob: torch.Tensor) -> None:
        """Copy what the policy did in one step: its distribution, an action (B, ...), its density."""
        self.actions[step], self.log_probs[step] = action, log_prob
        for (_, storage), (_, tensor) in zip(self.distribution.items(), dist.items(), strict=True):
            storage[step] = tensor

    def flat_graph(self) -> Graph:
        """Return the graphs of all transitions as views, (T * B, ...) per tensor."""
        return map_graph(lambda tensor: tensor.flatten(0, 1), self.graph)

    def with_prepared(self, graph: Graph) -> Rollout:
        """Return this rollout with prepared graphs, (T * B, ...) per tensor, in place of the raw ones."""
        prepared = copy.copy(self)
        prepared.graph = map_graph(lambda tensor: tensor.unflatten(0, (self.num_steps, self.num_envs)), graph)
        prepared.is_prepared = True
        return prepared

    def whole(self) -> Batch:
        """Return all transitions in the flattened (T * B) order, as views."""
        return self._batch(lambda tensor: tensor.flatten(0, 1))

    def select(self, index: torch.Tensor) -> Batch:
        """Gather transitions, one copy per tensor.

        Args:
            index: Positions in the flattened (T * B) order, int64 (M,).
        """
        return self._batch(lambda tensor: tensor.flatten(0, 1).index_select(0, index))

    def _batch(self, pick: Callable[[torch.Tensor], torch.Tensor]) -> Batch:
        return Batch(
            graph=map_graph(pick, self.graph),
            is_prepared=self.is_prepared,
            actions=pick(self.actions),
            log_probs=pick(self.log_probs),
            old=self.distribution.map(pick),
            advantages=pick(self.advantages),
            returns=pick(self.returns),
        )
