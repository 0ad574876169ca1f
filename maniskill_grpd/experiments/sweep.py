"""Sweeps: every combination of some options of `train` as a run of its own. A study without tests and pages."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.launchers import LauncherConfig
from maniskill_grpd.experiments.progress import job_line
from maniskill_grpd.experiments.runner import list_jobs, run_jobs
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import parse_options, require_positive
from maniskill_grpd.runs.folder import RUNS

Parse = Callable[[Sequence[str]], TrainConfig]
"""Reads the options of `train` from words of a command line."""


@dataclass(frozen=True, kw_only=True)
class SweepConfig(LauncherConfig):
    """Options of a sweep."""

    name: str
    """folder of the sweep under runs/"""
    grid: tuple[str, ...] = ()
    """options of `train` and their values, such as algorithm=bpp,ppo seed=1,2,3"""
    processes: int = 1
    """processes that train one run together"""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "processes")
        parse_options("grid", self.grid)


def run_sweep(config: SweepConfig, common: Sequence[str], parse: Parse) -> list[Job]:
    """Train all combinations, or only list them.

    Args:
        config: Options of the sweep.
        common: Options of `train` that all runs share, as on its command line.
        parse: Reads such options.

    Returns:
        The jobs that failed.

    Raises:
        ValueError: If a combination is not valid, or its folder holds something else, before any run has started.
        KeyboardInterrupt: If interrupted.
    """
    jobs = [make_job(config, combination, common, parse) for combination in combinations(config.grid)]
    if config.dry_run:
        list_jobs(jobs, config)
        return []
    failed = run_jobs(jobs, config, RUNS / config.name)
    print("\n".join(map(job_line, jobs)))
    return failed


def combinations(grid: Sequence[str]) -> Iterable[dict[str, str]]:
    """Return all combinations of a grid, each once.

    Args:
        grid: Options and their values, such as ("algorithm=bpp,ppo", "seed=1,2").

    Raises:
        ValueError: If the grid cannot be read.
    """
    axes = {key: str(values).split(",") for key, values in parse_options("grid", tuple(grid)).items()}
    for key, values in axes.items():
        if len(set(values)) < len(values):
            raise ValueError(f"grid names a value of {key} twice: {','.join(values)}")
    return [dict(zip(axes, values, strict=True)) for values in itertools.product(*axes.values())]


def make_job(config: SweepConfig, combination: dict[str, str], common: Sequence[str], parse: Parse) -> Job:
    """Return the job of one combination, see `run_sweep`."""
    label = "__".join(f"{key}={value.replace('/', '+')}" for key, value in combination.items()) or "run"
    chosen = [word for key, value in combination.items() for word in (f"--{key}", value)]
    training = Training(parse([*common, *chosen, "--exp_name", f"{config.name}/{label}"]), config.processes)
    job = Job(training.folder, training)
    job.check()
    return job
