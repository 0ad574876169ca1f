"""Tests of a checkpoint under every condition of a study: one file each, with the results of every episode.

Tests whose files are there are not played again. A condition that the task refuses leaves a file that says why, and the others
go on.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.experiments.records import TEST_FOLDER, is_played
from maniskill_grpd.experiments.studies import find_study
from maniskill_grpd.experiments.study import Condition, Study, Task, to_pairs
from maniskill_grpd.learning import CheckpointError, TrainConfig
from maniskill_grpd.learning.options import THREADS, check_ranges, require_positive
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.fingerprint import describe_task
from maniskill_grpd.runs.play import change_task, play
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED

REFUSALS = (ValueError, TypeError, CheckpointError)
"""What a task raises for an option it does not take, and a policy for observations it does not know."""


@dataclass(frozen=True, kw_only=True)
class ConditionTestConfig:
    """Options of the tests."""

    study: str
    """name of the study whose conditions are played"""
    checkpoint: Path
    """the checkpoint to test"""
    output: Path | None = None
    """folder the files go to, by default `tests` beside the checkpoint"""
    own_tasks: tuple[str, ...] = ()
    """further tasks for the studies of all tasks, of the form module:id, which runs the code of that module"""
    num_episodes: int = 100
    """episodes under each condition"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode"""
    num_envs: int = 50
    """number of environments that run in parallel"""
    torch_threads: int = 1
    """CPU threads PyTorch uses"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_envs")
        check_ranges(self, {"torch_threads": THREADS})

    @property
    def folder(self) -> Path:
        """Where the files go."""
        return self.output or self.checkpoint.parent / TEST_FOLDER

    def path(self, condition: Condition) -> Path:
        """File of a condition."""
        return self.folder / f"{condition.name}.json"


def run_tests(config: ConditionTestConfig) -> list[str]:
    """Play all conditions that have not been played.

    Returns:
        What went wrong, a line for each condition that was refused.

    Raises:
        ValueError: If there is no such study, or it has no task like that of the checkpoint; says what there is.
    """
    torch.set_num_threads(config.torch_threads)
    study = find_study(config.study)
    policy, contents = load_policy(config.checkpoint, allow_import=bool(config.own_tasks))
    trained = TrainConfig.from_dict(contents["train_config"])
    errors = []
    for condition in find_task(study, trained).conditions:
        plan = {
            "condition": condition.name,
            "sigma": condition.sigma,
            "num_episodes": config.num_episodes,
            "first_seed": config.seed,
            "global_step": contents["global_step"],
        }
        path = config.path(condition)
        if is_played(path, plan):
            continue
        try:
            results = play_condition(config, policy, trained, condition)
            print(f"{condition.name}: success at the end {results['mean'].get('success_at_end', float('nan')):.2f}")
        except REFUSALS as error:
            results = {"env_kwargs": dict(condition.env_options), "error": str(error)}
            errors.append(f"{condition.name}: {error}")
        write_atomically(path, {**plan, **results})
    return errors


def find_task(study: Study, trained: TrainConfig) -> Task:
    """Return the task of a study that a policy was trained on.

    If several have its id, options decide; if only one has, a policy trained with other options is welcome too.

    Raises:
        ValueError: If there is none, listing the tasks there are.
    """
    options = {key: value for key, value in trained.env_options.items() if key != "num_threads"}
    candidates = [task for task in study.tasks if task.env_id == trained.env_id]
    if len(candidates) > 1:
        candidates = [task for task in candidates if task.options == options]
    if not candidates:
        tasks = "; ".join(" ".join([task.env_id, *to_pairs(task.options)]) for task in study.tasks)
        given = " ".join([trained.env_id, *to_pairs(options)])
        raise ValueError(f"study {study.name!r} has no task like that of the checkpoint, {given}; it has: {tasks}")
    return candidates[0]


def play_condition(config: ConditionTestConfig, policy: Policy, trained: TrainConfig, condition: Condition) -> dict[str, Any]:
    """Play the episodes of one condition and return means and values of all metrics."""
    task = change_task(trained, env_kwargs=to_pairs(condition.env_options))
    seeds = range(config.seed, config.seed + config.num_episodes)
    episodes = play(policy, task, seeds, config.num_envs, sigma=condition.sigma)
    return {
        "env_kwargs": task.env_options,
        "fingerprint": describe_task(task)["fingerprint"],
        "mean": {name: values.double().mean().item() for name, values in episodes.items()},
        "episodes": {name: values.tolist() for name, values in episodes.items()},
    }


def write_atomically(path: Path, results: dict[str, Any]) -> None:
    """Write a file that is whole at every moment."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(results) + "\n", encoding="utf-8")
    temporary.replace(path)
