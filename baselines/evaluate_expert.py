"""Play the scripted expert of a task: the reference beside which policies stand.

python baselines/evaluate_expert.py --env_id RopeShaping-v1 --env_kwargs num_grippers=3
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import tyro
from run_setup import describe_episodes, make_env

from maniskill_grpd.experts import Expert, make_expert
from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.learning.config import require_positive


@dataclass(frozen=True, kw_only=True)
class ExpertEvalConfig:
    """Options of the evaluation."""

    env_id: str = "RopeShaping-v1"
    """id of the task"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs"""
    num_episodes: int = 100
    """number of episodes, each with its own seed"""
    seed: int = 1_000_000
    """seed of the first episode"""
    num_envs: int = 50
    """number of environments that run in parallel"""
    json: Path | None = None
    """also write the results, per episode, to this file"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_envs")


class ExpertActor:
    """An expert that is asked as a policy is; it looks at the simulation and not at the graph."""

    def __init__(self, expert: Expert) -> None:
        self._expert = expert

    def act(self, graph: Any, **_: Any) -> torch.Tensor:
        """Return the expert's action for the present state of all worlds."""
        return self._expert.act()


def evaluate_expert(config: ExpertEvalConfig) -> dict[str, torch.Tensor]:
    """Play one episode per seed and print a table.

    Returns:
        Results per episode, as `evaluate_policy` gives them.
    """
    torch.set_num_threads(1)
    task = TrainConfig(env_id=config.env_id, env_kwargs=config.env_kwargs)
    env = make_env(task, min(config.num_envs, config.num_episodes))
    seeds = range(config.seed, config.seed + config.num_episodes)
    episodes = evaluate_policy(ExpertActor(make_expert(config.env_id, env)), env, seeds)
    env.close()
    print(describe_episodes(episodes))
    if config.json is not None:
        write_results(config, task, episodes)
    return episodes


def write_results(config: ExpertEvalConfig, task: TrainConfig, episodes: dict[str, torch.Tensor]) -> None:
    """Write means and per-episode values, in the form in which tests of policies are written."""
    results = {
        "condition": "as trained",
        "sigma": 0.0,
        "env_kwargs": task.env_options,
        "num_episodes": config.num_episodes,
        "first_seed": config.seed,
        "global_step": 0,
        "mean": {name: values.double().mean().item() for name, values in episodes.items()},
        "episodes": {name: values.tolist() for name, values in episodes.items()},
    }
    config.json.parent.mkdir(parents=True, exist_ok=True)
    config.json.write_text(json.dumps(results) + "\n", encoding="utf-8")


def main(arguments: Sequence[str]) -> int:
    """Evaluate; report what the user can mend in one line instead of a traceback."""
    try:
        evaluate_expert(tyro.cli(ExpertEvalConfig, args=list(arguments), description=__doc__))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
