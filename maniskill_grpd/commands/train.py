"""Train a policy on a deformable-object task.

maniskill-grpd train --env_id RopeShaping-v1 --policy grpd --algorithm bpp --num_envs 64 --total_timesteps 1_000_000 --seed 1

With --demonstrations FILE the policy first clones what `record` wrote, and training goes on from there with little noise, which
is not correlated whatever the task recommends.

What a task recommends for its trainings (TRAINING in its class) stands where the command line is silent, and is shown at the
start; --no_recommended leaves it out.

Everything goes to runs/{exp_name}/: config.json, metrics.jsonl, TensorBoard events, last.pt, best_ckpt.pt, final_ckpt.pt,
learning_curve.png and a video. Ctrl-C, SIGTERM and SIGHUP end a run after the iteration, with a checkpoint. A run that was
stopped goes on with --resume runs/{exp_name}; with --allow_import its task may be module:id, which runs the code of that module.

One process per core is the fast way on a CPU; num_envs is then shared among the processes:
torchrun --nproc_per_node=2 -m maniskill_grpd train --env_id RopeShaping-v1 --exp_name two_processes
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

from maniskill_grpd.commands.run_command import parse_options, report_errors
from maniskill_grpd.imitation.warm_start import start_from_demonstrations
from maniskill_grpd.learning import TrainConfig, TrainingStoppedError
from maniskill_grpd.learning.allocator import keep_freed_memory
from maniskill_grpd.learning.config import NO_RECOMMENDED
from maniskill_grpd.learning.workers import leave_workers
from maniskill_grpd.program import command_line
from maniskill_grpd.runs.recommended import complete_env_kwargs, recommended_settings
from maniskill_grpd.runs.resumption import resumed_options
from maniskill_grpd.runs.stop_request import stop_request
from maniskill_grpd.runs.training import train


def train_and_report(config: TrainConfig) -> int | None:
    """Train, and say what can be done with the result."""
    with stop_request() as request:
        try:
            run_dir = train(config, request, start_from_demonstrations if config.demonstrations else None)
        except TrainingStoppedError as stopped:
            goes_on = f"; go on: {command_line(['train', '--resume', str(stopped.run_dir)])}" if stopped.is_saved else ""
            print(f"{stopped}{goes_on}", file=sys.stderr)
            return request.exit_code
    print(f"done: {command_line(['evaluate', '--checkpoint', str(run_dir / 'final_ckpt.pt')])}")


def parse_train_options(arguments: Sequence[str]) -> TrainConfig:
    """Parse the words after `train`; where they are silent, the options of a resumed run or the defaults stand."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--resume", type=Path)
    finder.add_argument(NO_RECOMMENDED, "--no-recommended", action="store_true")
    finder.add_argument("--allow_import", "--allow-import", action="store_true")  # no option of a training, nor of its record
    found, words = finder.parse_known_args(arguments)
    if found.resume is None:
        return _parse_new(words, is_plain=found.no_recommended)
    default = resumed_options(found.resume, allow_import=found.allow_import)
    return parse_options(__name__, TrainConfig, [*words, "--resume", str(found.resume)], default)


def _parse_new(words: Sequence[str], *, is_plain: bool) -> TrainConfig:
    """Parse the options of a new training; where they are silent, what its task recommends or the defaults stand."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--env_id", "--env-id", default=TrainConfig.env_id)
    finder.add_argument("--demonstrations")
    given = finder.parse_known_args(words)[0]
    settings = {} if is_plain else recommended_settings(given.env_id)
    if given.demonstrations:  # what explores from nothing is more than what a clone can bear
        settings = {name: value for name, value in settings.items() if name not in ("noise_correlation", "noise_schedule")}
    config = parse_options(__name__, TrainConfig, words, dataclasses.replace(TrainConfig(), **settings))
    return dataclasses.replace(config, env_kwargs=complete_env_kwargs(config.env_kwargs, settings.get("env_kwargs", ())))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    keep_freed_memory()
    try:
        return report_errors(lambda: train_and_report(parse_train_options(arguments)))
    finally:
        leave_workers()
