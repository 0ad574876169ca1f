"""Collecting rollouts from a vector environment."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import torch

from maniskill_grpd.learning.action_noise import ActionNoise
from maniskill_grpd.learning.finite import check_finite, check_graph_finite
from maniskill_grpd.learning.protocols import ActorCritic, GraphVecEnv
from maniskill_grpd.learning.rollout import Graph, Rollout
from maniskill_grpd.learning.update import autocast_policy
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.learning.workers import Workers
from maniskill_grpd.policies import ActionDistribution


class Collector:
    """Steps environments with a policy and stores what happens.

    The environments reset themselves at the end of an episode in the same step, and then report
    `info["final_observation"]` and `info["final_info"]` (ManiSkillVectorEnv).

    Args:
        envs: Vector environment whose observations hold a graph under the key "graph".
        num_steps: Steps of a rollout.
        disturb: Changes what the policy sees, called as disturb(graph, generator); by default
            nothing is changed.
        workers: The processes whose episodes are counted together.
        amp: Whether the policy computes in bfloat16, as in the updates.

    Attributes:
        noise: The action noise.
        env_seconds: Time the environments took in the last rollout [s].
    """

    def __init__(
        self,
        envs: GraphVecEnv,
        num_steps: int,
        disturb: Callable[[Graph, torch.Generator], Graph] | None = None,
        workers: Workers | None = None,
        amp: bool = False,
    ) -> None:
        self.envs = envs
        self._disturb = disturb or (lambda graph, generator: graph)
        self._workers = workers or Workers()
        self._amp = amp
        self.noise = ActionNoise()
        self.num_steps = num_steps
        self.env_seconds = 0.0
        self.rollout: Rollout | None = None
        self._graph: Graph | None = None

    def reset(self, seeds: list[int]) -> None:
        """Start a new episode in every environment.

        Args:
            seeds: One seed per environment.
        """
        obs, _ = self.envs.reset(seed=seeds)
        self._graph = obs["graph"]
        self.noise.restart()
        check_graph_finite(self._graph, "after a reset")

    @torch.no_grad()
    def collect(
        self, policy: ActorCritic, value_scale: ValueScale, generator: torch.Generator, where: str
    ) -> tuple[Rollout, dict[str, float]]:
        """Take `num_steps` steps in every environment with sampled actions.

        Args:
            policy: Called as policy(graph) -> (distribution, value output).
            value_scale: Turns value outputs into values.
            generator: Source of the action noise, on the device of the policy.
            where: When in training this is, for error messages.

        Returns:
            The rollout, whose storage the next call overwrites, and the means over the episodes
            that ended in it of their metrics (`return`, `success_once`, ...).

        Raises:
            NonFiniteError: If an observation, reward or action is not finite.
        """
        episodes = EpisodeMetrics()
        self.env_seconds = 0.0
        graph = self._disturb(self._graph, generator)
        for step in range(self.num_steps):
            place = f"{where}, step {step}"
            dist, output = autocast_policy(policy, graph, self._amp)
            noise = self.noise.draw(dist.mean, generator)
            action = dist.sample(generator, noise)
            log_prob = dist.log_prob(action)
            _check_decision(graph, log_prob, output, place)
            rollout = self._storage(graph, dist)
            rollout.store_graph(step, graph)
            rollout.store_decision(step, dist, action, log_prob)
            rollout.values[step] = value_scale.denormalize(output)

            start = time.perf_counter()
            obs, reward, terminated, truncated, info = self.envs.step(action)
            self.env_seconds += time.perf_counter() - start
            self._graph = obs["graph"]
            graph = self._disturb(self._graph, generator)
            check_finite("the reward", reward, place)
            rollout.rewards[step] = reward
            rollout.terminated[step], rollout.truncated[step] = terminated, truncated
            if "_final_info" in info:
                episodes.add(info["final_info"], info["_final_info"])
            if rollout.truncated[step].any():
                final = self._disturb(info["final_observation"]["graph"], generator)
                values = value_scale.denormalize(policy.value(final))
                rollout.final_values[step] = torch.where(rollout.truncated[step], values, 0.0)
        check_graph_finite(graph, f"{where}, after the last step")
        rollout.next_value.copy_(value_scale.denormalize(policy.value(graph)))
        return rollout, episodes.means(self._workers)

    def _storage(self, graph: Graph, dist: ActionDistribution) -> Rollout:
        if self.rollout is None:
            self.rollout = Rollout(self.num_steps, graph, dist)
        return self.rollout


class EpisodeMetrics:
    """Means over ended episodes of what their last `info` held."""

    def __init__(self) -> None:
        self._sums: dict[str, float] = {}
        self._count = 0

    def add(self, final_info: dict[str, Any], ended: torch.Tensor) -> None:
        """Add the environments whose episode ended in this step.

        Args:
            final_info: Info of the last step, (B,) per tensor, with the episode's metrics under
                "episode".
            ended: bool (B,).
        """
        self._count += int(ended.sum())
        for key, value in {**float_metrics(final_info), **final_info.get("episode", {})}.items():
            total = value[ended].double().sum().item()
            self._sums[key] = self._sums.get(key, 0.0) + total

    def means(self, workers: Workers) -> dict[str, float]:
        """Return the mean of each metric over the processes; nothing if no episode ended."""
        sums, count = self._sums, self._count
        if workers.size > 1:
            # Episodes may have ended in some of the processes only.
            parts = workers.gather((sums, count))
            count = sum(number for _, number in parts)
            names = dict.fromkeys(name for part, _ in parts for name in part)
            sums = {name: sum(part.get(name, 0.0) for part, _ in parts) for name in names}
        return {key: total / count for key, total in sums.items()}


def float_metrics(info: dict[str, Any]) -> dict[str, torch.Tensor]:
    """Return the entries of an info dictionary that are one float per environment, (B,)."""
    return {
        key: value
        for key, value in info.items()
        if isinstance(value, torch.Tensor) and value.is_floating_point() and value.ndim == 1
    }


def _check_decision(graph: Graph, log_prob: torch.Tensor, output: torch.Tensor, place: str) -> None:
    """Raise if the policy produced a non-finite number, blaming the observation where it is guilty.

    One check per step: a NaN anywhere in an observation reaches the action or the value.
    """
    if torch.isfinite(log_prob + output).all():
        return
    check_graph_finite(graph, place)
    check_finite("the action of the policy", log_prob, place)
    check_finite("the value of the policy", output, place)
