"""Play the scripted expert of a task: the reference beside which policies stand.

maniskill-grpd evaluate_expert --env_id RopeShaping-v1 --env_kwargs num_grippers=3
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.imitation.expert_actor import play_expert
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import require_positive
from maniskill_grpd.runs.episodes import describe_episodes, write_episodes
from maniskill_grpd.runs.fingerprint import describe_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED


@dataclass(frozen=True, kw_only=True)
class ExpertConfig:
    """Options of the evaluation."""

    env_id: str = "RopeShaping-v1"
    """id of the task"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs"""
    num_episodes: int = 100
    """number of episodes, each with its own seed"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode"""
    num_envs: int = 50
    """number of environments that run in parallel"""
    json: Path | None = None
    """also write the results, per episode, to this file, in the form in which the tests of a study are written"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_envs")


def evaluate_expert(config: ExpertConfig) -> None:
    """Play one episode per seed and print a table."""
    torch.set_num_threads(1)
    task = TrainConfig(env_id=config.env_id, env_kwargs=config.env_kwargs)
    episodes = play_expert(task, range(config.seed, config.seed + config.num_episodes), config.num_envs)
    print(describe_episodes(episodes))
    if config.json is not None:
        facts = {"num_episodes": config.num_episodes, "first_seed": config.seed, "env_kwargs": task.env_options}
        facts["fingerprint"] = describe_task(task)["fingerprint"]
        write_episodes(config.json, {"condition": "as trained", "sigma": 0.0, "global_step": 0, **facts}, episodes)


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(evaluate_expert, ExpertConfig, arguments)
