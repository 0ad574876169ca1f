"""Evaluation of a policy on given seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch

from maniskill_grpd.learning.collector import float_metrics
from maniskill_grpd.learning.protocols import ActorCritic, GraphVecEnv

_MAX_EPISODE_STEPS = 100_000
"""An environment without a time limit would never end an episode."""


@torch.no_grad()
def evaluate_policy(
    policy: ActorCritic,
    env: GraphVecEnv,
    seeds: Sequence[int],
    deterministic: bool = True,
    *,
    generator: torch.Generator | None = None,
    on_step: Callable[[], None] | None = None,
) -> dict[str, torch.Tensor]:
    """Play one episode per seed and report each.

    Seeds are played in chunks of `env.num_envs`. An episode ends at the time limit, or where the
    environment resets itself (a ManiSkillVectorEnv that does not ignore terminations).

    Args:
        policy: Has act(graph, deterministic=, generator=) -> actions.
        env: A batched ManiSkill environment, plain or in a ManiSkillVectorEnv.
        seeds: One per episode.
        deterministic: Act with the mean of the distribution instead of a sample.
        generator: Source of the action noise if not deterministic.
        on_step: Called after the reset and after every step, to render for instance.

    Returns:
        Per-episode tensors on the CPU, (len(seeds),), in the order of the seeds: `return`,
        `episode_len`; `success_once` and `success_at_end` (bool) where the environment reports
        success, likewise `fail_once` and `fail_at_end`; and every float entry of the last step's
        info, such as `mean_distance`.

    Raises:
        ValueError: If `seeds` is empty.
        RuntimeError: If an episode does not end.
    """
    if not len(seeds):
        raise ValueError("seeds must not be empty")
    num_envs = env.num_envs if hasattr(env, "num_envs") else env.unwrapped.num_envs
    chunks = []
    for start in range(0, len(seeds), num_envs):
        chunk = [int(seed) for seed in seeds[start : start + num_envs]]
        # A batch has a fixed size: the last one is filled up and the fillers are thrown away.
        padded = chunk + [chunk[-1]] * (num_envs - len(chunk))
        result = _play(policy, env, padded, deterministic, generator, on_step)
        chunks.append({key: value[: len(chunk)] for key, value in result.items()})
    return {key: torch.cat([chunk[key] for chunk in chunks]) for key in chunks[0]}


def _play(
    policy: ActorCritic,
    env: GraphVecEnv,
    seeds: list[int],
    deterministic: bool,
    generator: torch.Generator | None,
    on_step: Callable[[], None] | None,
) -> dict[str, torch.Tensor]:
    """Play one episode in every environment."""
    obs, _ = env.reset(seed=seeds)
    record = _EpisodeRecord(len(seeds))
    for _ in range(_MAX_EPISODE_STEPS):
        if on_step is not None:
            on_step()
        action = policy.act(obs["graph"], deterministic=deterministic, generator=generator)
        obs, reward, _, truncated, info = env.step(action)
        # A self-resetting environment has put the true last info aside.
        ended = torch.as_tensor(info.get("_final_info", truncated)).cpu()
        record.add(reward, info.get("final_info", info), ended.expand(len(seeds)))
        if record.ended.all():
            break
    else:
        raise RuntimeError(f"no end of the episode after {_MAX_EPISODE_STEPS} steps")
    if on_step is not None:
        on_step()
    return record.result()


class _EpisodeRecord:
    """Running metrics of one episode per environment, each closed when it ends."""

    def __init__(self, num_envs: int) -> None:
        self.ended = torch.zeros(num_envs, dtype=torch.bool)
        self._sums = {"return": torch.zeros(num_envs), "episode_len": torch.zeros(num_envs)}
        self._once: dict[str, torch.Tensor] = {}
        self._last: dict[str, torch.Tensor] = {}

    def add(self, reward: torch.Tensor, info: dict[str, Any], ended: torch.Tensor) -> None:
        """Add one step of the environments that have not ended before it."""
        running = ~self.ended
        self._sums["return"] += torch.where(running, reward.cpu(), 0.0)
        self._sums["episode_len"] += running
        for name in ("success", "fail"):
            if name in info:
                now = info[name].cpu().bool()
                once = self._once.setdefault(f"{name}_once", torch.zeros_like(now))
                once |= now & running
                self._keep(f"{name}_at_end", now, running)
        for name, value in float_metrics(info).items():
            self._keep(name, value.cpu(), running)
        self.ended = self.ended | ended

    def _keep(self, name: str, value: torch.Tensor, running: torch.Tensor) -> None:
        previous = self._last.get(name, value)
        self._last[name] = torch.where(running, value, previous)

    def result(self) -> dict[str, torch.Tensor]:
        return {**self._once, **self._sums, **self._last}
