"""Train a policy on a deformable-object task.

maniskill-grpd train --env_id RopeShaping-v1 --policy grpd --algorithm bpp --num_envs 64 --total_timesteps 1_000_000 --seed 1

Everything goes to runs/{exp_name}/: config.json, metrics.jsonl, TensorBoard events, last.pt, best_ckpt.pt, final_ckpt.pt,
learning_curve.png and a video. A run that was stopped goes on with --resume runs/{exp_name}.

With --allow_import a resumed run may name its task as module:id, which runs the code of that module.

One process per core is the fast way on a CPU; num_envs is then shared among the processes:

torchrun --nproc_per_node=2 -m maniskill_grpd train --env_id RopeShaping-v1 --exp_name two_processes
"""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Sequence
from pathlib import Path

from maniskill_grpd.commands.run_command import parse_options, report_errors
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.allocator import keep_freed_memory
from maniskill_grpd.learning.workers import leave_workers
from maniskill_grpd.runs.record import read_run_config
from maniskill_grpd.runs.training import train

ALLOW_IMPORT = "--allow_import"
"""No option of a training, and so none of its record: whether a resumed run may name its task as module:id."""


def train_and_report(config: TrainConfig) -> None:
    """Train, and say what can be done with the result."""
    run_dir = train(config)
    print(f"done: maniskill-grpd evaluate --checkpoint {run_dir / 'final_ckpt.pt'}")


def default_options(arguments: Sequence[str]) -> TrainConfig:
    """Return the options that stand where the command line is silent: with --resume those of that run."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--resume", type=Path)
    resumed = finder.parse_known_args(arguments)[0].resume
    if resumed is None:
        return TrainConfig()
    config = read_run_config(resumed, allow_import=ALLOW_IMPORT in arguments)
    # The weights that the run began with are those of its own checkpoint by now.
    checkpoint = None if (resumed / "last.pt").exists() else config.checkpoint
    return dataclasses.replace(config, resume=None, checkpoint=checkpoint)


def parse_train_options(arguments: Sequence[str]) -> TrainConfig:
    """Parse the words after `train`, as a sweep does before it starts any of them.

    Raises:
        UsageError: If they cannot be read.
    """
    words = [word for word in arguments if word != ALLOW_IMPORT]
    return parse_options(__name__, TrainConfig, words, default_options(arguments))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    keep_freed_memory()
    try:
        return report_errors(lambda: train_and_report(parse_train_options(arguments)))
    finally:
        leave_workers()
