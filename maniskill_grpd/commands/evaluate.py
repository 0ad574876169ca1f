"""Evaluate a checkpoint on unseen start and goal poses.

maniskill-grpd evaluate --checkpoint runs/NAME/final_ckpt.pt --num_episodes 200

The task and its options are those the policy was trained on unless others are given: another number of nodes or grippers is
fine, a task with other observation channels is refused.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.learning.options import to_arguments
from maniskill_grpd.runs.checkpoint_card import write_card
from maniskill_grpd.runs.episodes import describe_episodes, write_episodes
from maniskill_grpd.runs.evaluation import Evaluation, EvaluationConfig, evaluate, record_worst_and_median
from maniskill_grpd.runs.fingerprint import describe_task
from maniskill_grpd.runs.video import record_video


def evaluate_and_report(config: EvaluationConfig) -> None:
    """Evaluate, print a table and write what was asked for."""
    found = evaluate(config)
    last = config.seed + config.num_episodes - 1
    print(
        f"{found.task.env_id} {' '.join(found.task.env_kwargs)}: {config.num_episodes} episodes, seeds {config.seed} to {last}, "
        f"policy after {found.global_step:,} steps"
    )
    print(describe_episodes(found.episodes))
    if config.html is not None:
        print(f"replay: {record_worst_and_median(config, found)}")
    if config.json is not None:
        write_episodes(config.json, _facts(config, found), found.episodes, indent=2)
    if config.card is not None:
        words = to_arguments(dataclasses.replace(config, card=None, html=None))
        write_card(config.card, config.checkpoint, found.contents, found.policy, words, found.episodes, config.html)
    if config.video is not None:
        seeds = range(config.seed, config.seed + min(4, config.num_episodes))
        print(f"video: {record_video(found.policy, found.task, seeds, config.video)}")


def _facts(config: EvaluationConfig, found: Evaluation) -> dict[str, object]:
    return {
        "checkpoint": str(config.checkpoint),
        "env_id": found.task.env_id,
        "env_kwargs": found.task.env_options,
        "first_seed": config.seed,
        "num_episodes": config.num_episodes,
        "sigma": config.sigma,
        "global_step": found.global_step,
        "fingerprint": describe_task(found.task)["fingerprint"],
    }


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(evaluate_and_report, EvaluationConfig, arguments)
