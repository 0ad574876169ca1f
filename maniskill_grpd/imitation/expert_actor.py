"""Experts where policies are played."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch

from maniskill_grpd.experts import Expert, make_expert
from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.runs.environments import make_env


class ExpertActor:
    """An expert that is asked as a policy is; it looks at the simulation and not at the graph."""

    def __init__(self, expert: Expert) -> None:
        self._expert = expert

    def act(self, graph: Any, **_: Any) -> torch.Tensor:
        """Return the expert's action for the present state of all worlds."""
        return self._expert.act()


def play_expert(task: TrainConfig, seeds: Sequence[int], num_envs: int) -> dict[str, torch.Tensor]:
    """Play one episode of a task's expert per seed.

    Args:
        task: Names the task and its options.
        seeds: One per episode.
        num_envs: Most environments that run in parallel.

    Returns:
        Results per episode, as `evaluate_policy` gives them.

    Raises:
        ValueError: If the task has no expert.
    """
    env = make_env(task, min(num_envs, len(seeds)))
    episodes = evaluate_policy(ExpertActor(make_expert(task.env_id, env)), env, seeds)
    env.close()
    return episodes
