"""Replays of a policy at work: html files that show episodes from all sides, without a server."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.learning.protocols import ActorCritic
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.tasks.pictures.world_parts import WorldParts
from maniskill_grpd.viewer.replay import Replay


class Filming:
    """A replay of some worlds of an environment; `shoot` after the reset and after every step.

    Args:
        env: The environment, plain or wrapped.
        worlds: Which worlds are shown, side by side.
        title: What the page says above.
    """

    def __init__(self, env: Any, worlds: Sequence[int], title: str) -> None:
        self._base = env.unwrapped
        self._parts = WorldParts(self._base, worlds)
        self._worlds = list(worlds)
        self.replay = Replay(title, self._base.control_timestep, self._parts.towards_viewer)

    def shoot(self) -> None:
        """Append what there is to see now."""
        solved = self._base.measurement.success[self._worlds]
        step = int(self._base.elapsed_steps[self._worlds[0]])
        self.replay.add(self._parts.parts(), f"step {step} · solved {int(solved.sum())} of {len(solved)}")


def record_replay(
    actor: ActorCritic, task: TrainConfig, seeds: Sequence[int], path: Path, title: str, *, stochastic: bool = False
) -> dict[str, torch.Tensor]:
    """Play one episode per seed, side by side, and write the replay.

    Args:
        actor: Who acts.
        task: Names the task and its options.
        seeds: One per episode, from left to right.
        path: The html file to write.
        title: What the page says above.
        stochastic: Whether to sample actions.

    Returns:
        Results per episode, as `evaluate_policy` gives them.
    """
    env = make_env(task, len(seeds))
    filming = Filming(env, range(len(seeds)), title)
    generator = torch.Generator(env.unwrapped.device).manual_seed(int(seeds[0])) if stochastic else None
    episodes = evaluate_policy(actor, env, seeds, not stochastic, generator=generator, on_step=filming.shoot)
    env.close()
    filming.replay.write(path)
    return episodes


def worst_and_median(returns: torch.Tensor) -> tuple[int, int]:
    """Return which of some episodes has the lowest return, and which the median (of two in the middle the lower), (E,)."""
    order = returns.argsort(stable=True)
    return int(order[0]), int(order[(len(order) - 1) // 2])
