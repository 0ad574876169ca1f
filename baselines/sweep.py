"""Train every combination of options as a job of its own, on this machine or on a Slurm cluster.

python baselines/sweep.py --name rivals --grid algorithm=bpp,ppo seed=1,2,3 --jobs 2 -- \
    --env_id RopeShaping-v1 --total_timesteps 1_000_000

What stands behind -- goes to baselines/train.py in every run; runs/rivals/ gets one folder per combination. The same command
again goes on where a stopped sweep was: finished runs are left alone, broken ones resume from their last checkpoint. On Slurm
(--cluster slurm --slurm partition=gpu gpus_per_node=1) jobs that are preempted or time out are queued again and resume, too.
Needs submitit: pip install submitit
"""

from __future__ import annotations

import argparse
import itertools
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maniskill_grpd.commands.run_command import UsageError
from maniskill_grpd.commands.train import parse_train_options
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import parse_options
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.runs.record import RUNS

TRAIN = Path(__file__).with_name("train.py").resolve()

SHOWN = (("return", "train/return"), ("success", "train/success_once"), ("eval", "eval/success_at_end"))
"""Columns of the table and the tags they show, if a run has them."""


@dataclass(frozen=True)
class Run:
    """One combination of options.

    Attributes:
        folder: Where it goes.
        arguments: Those of train.py.
        num_processes: Processes that train it together.
    """

    folder: Path
    arguments: tuple[str, ...]
    num_processes: int = 1

    def command(self) -> list[str]:
        """Return what starts the run, or continues it if it has a checkpoint."""
        launcher = [sys.executable]
        if self.num_processes > 1:
            launcher += ["-m", "torch.distributed.run", "--standalone", f"--nproc_per_node={self.num_processes}"]
        if (self.folder / "last.pt").exists():
            return [*launcher, str(TRAIN), "--resume", str(self.folder)]
        return [*launcher, str(TRAIN), *self.arguments]

    def __call__(self) -> None:
        """Train; what a job does.

        Raises:
            RuntimeError: If train.py fails, with the last lines it wrote.
        """
        if self.folder.exists() and not (self.folder / "last.pt").exists():
            shutil.rmtree(self.folder)  # broken off before the first checkpoint
        done = subprocess.run(self.command(), stderr=subprocess.PIPE, text=True, check=False)
        if done.returncode:
            raise RuntimeError("\n".join(done.stderr.splitlines()[-5:]))

    def checkpoint(self) -> Any:
        """Return the job that goes on after a preemption (called by submitit)."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)

    def is_finished(self) -> bool:
        """Return whether the last checkpoint of the run is there."""
        return (self.folder / "final_ckpt.pt").exists()

    def describe(self, total: int) -> dict[str, str]:
        """Return the columns of the table that its log tells."""
        rows = read_rows(self.folder / "metrics.jsonl")
        step = rows[-1]["global_step"] if rows else 0
        last = {key: value for row in rows for key, value in row.items()}
        cells = {name: f"{last[tag]:.3g}" if tag in last else "" for name, tag in SHOWN}
        speed = f"{last['charts/SPS']:,.0f}" if rows else ""
        return {"steps": f"{step:,} / {total:,}", **cells, "steps/s": speed}


class Sweep:
    """Submits runs, at most so many at a time, and shows how they go.

    Args:
        runs: The runs and their options.
        executor: A submitit executor.
        num_jobs: Runs at a time.
    """

    def __init__(self, runs: Mapping[Run, TrainConfig], executor: Any, num_jobs: int) -> None:
        self.runs = runs
        self._executor = executor
        self._num_jobs = num_jobs
        self._jobs: dict[Run, Any] = {}
        self._waiting = [run for run in runs if not run.is_finished()]

    def run(self, interval: float) -> list[Run]:
        """Run to the end.

        Args:
            interval: Time between two looks at the runs [s].

        Returns:
            The runs that failed.
        """
        shown = 0
        try:
            while True:
                self._submit()
                shown = show(self.table(), shown)
                if not self._waiting and all(job.done() for job in self._jobs.values()):
                    return [run for run, job in self._jobs.items() if job.exception() is not None]
                time.sleep(interval)
        except KeyboardInterrupt:
            for job in self._jobs.values():
                job.cancel()
            raise

    def table(self) -> str:
        """Return the state of all runs, one line each."""
        rows = [
            {"run": run.folder.name, "state": self._state(run), **run.describe(config.total_timesteps)}
            for run, config in self.runs.items()
        ]
        widths = {key: max(len(key), *(len(row[key]) for row in rows)) for key in rows[0]}
        lines = ["  ".join(key.ljust(width) for key, width in widths.items())]
        lines += ["  ".join(row[key].ljust(width) for key, width in widths.items()) for row in rows]
        return "\n".join(line.rstrip() for line in lines)

    def failure(self, run: Run) -> str:
        """Return why a run failed."""
        return str(self._jobs[run].exception())

    def _submit(self) -> None:
        active = sum(not job.done() for job in self._jobs.values())
        while self._waiting and active < self._num_jobs:
            run = self._waiting.pop(0)
            self._jobs[run] = self._executor.submit(run)
            active += 1

    def _state(self, run: Run) -> str:
        job = self._jobs.get(run)
        if job is not None and job.done():
            return "failed" if job.exception() is not None else "done"
        if job is not None:
            return job.state.lower()
        return "waiting" if run in self._waiting else "done"


def show(table: str, previous_lines: int) -> int:
    """Print a table, on a terminal in place of the one before, and return its number of lines."""
    if previous_lines and sys.stdout.isatty():
        sys.stdout.write(f"\033[{previous_lines}A\033[J")
    sys.stdout.write(table + "\n")
    sys.stdout.flush()
    return table.count("\n") + 1


def make_runs(name: str, grid: Sequence[str], common: Sequence[str], num_processes: int = 1) -> dict[Run, TrainConfig]:
    """Make the runs of a grid, checked before any of them starts.

    Args:
        name: Folder of the sweep under runs/.
        grid: Options and their values, such as ("algorithm=bpp,ppo", "seed=1,2").
        common: Arguments of train.py that all runs share.
        num_processes: Processes per run.

    Raises:
        ValueError: If the grid cannot be read.
        UsageError: If a combination is not a valid configuration.
    """
    axes = {key: str(values).split(",") for key, values in parse_options("grid", tuple(grid)).items()}
    runs = {}
    for values in itertools.product(*axes.values()):
        chosen = dict(zip(axes, values, strict=True))
        label = "__".join(f"{key}={value}" for key, value in chosen.items()) or "run"
        arguments = [*common, *(part for key, value in chosen.items() for part in (f"--{key}", value))]
        arguments += ["--exp_name", f"{name}/{label}"]
        run = Run(RUNS / name / label, tuple(arguments), num_processes)
        runs[run] = parse_train_options(arguments)
    return runs


def make_executor(cluster: str, folder: Path, parameters: Mapping[str, Any]) -> Any:
    """Make what runs the jobs.

    Args:
        cluster: "local" or "slurm".
        folder: For logs and pickled jobs.
        parameters: Of submitit, for Slurm with its prefix, such as slurm_partition.

    Raises:
        RuntimeError: If submitit is not installed.
        ValueError: If it does not know a parameter.
    """
    try:
        import submitit  # optional
    except ImportError as error:
        raise RuntimeError("a sweep needs submitit: pip install submitit") from error
    # Jobs import this file and the package under which it runs.
    paths = [str(TRAIN.parent), str(TRAIN.parents[1]), os.environ.get("PYTHONPATH", "")]
    os.environ["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    executor = submitit.AutoExecutor(folder=str(folder), cluster=cluster)
    try:
        executor.update_parameters(**parameters)
    except NameError as error:
        raise ValueError(f"--slurm: {error}") from error
    return executor


def read_arguments(arguments: Sequence[str]) -> tuple[argparse.Namespace, list[str]]:
    """Split the command line into the options of the sweep and those of train.py behind --."""
    own, separator, common = list(arguments), "--" in arguments, []
    if separator:
        place = own.index("--")
        own, common = own[:place], own[place + 1 :]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--name", required=True, help="folder of the sweep under runs/")
    parser.add_argument("--grid", nargs="+", default=[], metavar="KEY=V1,V2", help="options of train.py and their values")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time")
    parser.add_argument("--processes", type=int, default=1, help="processes that train one run together")
    parser.add_argument("--cluster", choices=("local", "slurm"), default="local", help="where jobs run")
    parser.add_argument("--slurm", nargs="*", default=[], metavar="KEY=VALUE", help="options of the Slurm jobs")
    parser.add_argument("--hours", type=float, default=24.0, help="time limit of a job; a longer run is queued again")
    parser.add_argument("--interval", type=float, default=10.0, help="seconds between two looks at the runs")
    return parser.parse_args(own), common


def main(arguments: Sequence[str]) -> int:
    """Run a sweep; report what the user can mend in one line instead of a traceback."""
    options, common = read_arguments(arguments)
    try:
        runs = make_runs(options.name, options.grid, common, options.processes)
        parameters = {f"slurm_{k}": v for k, v in parse_options("slurm", tuple(options.slurm)).items()}
        parameters["timeout_min"] = int(60 * options.hours)
        executor = make_executor(options.cluster, RUNS / options.name / "jobs", parameters)
        sweep = Sweep(runs, executor, options.jobs)
        failed = sweep.run(options.interval)
    except (ValueError, OSError, RuntimeError, UsageError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on from the last checkpoints", file=sys.stderr)
        return 130
    for run in failed:
        print(f"failed: {run.folder}: {sweep.failure(run)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
