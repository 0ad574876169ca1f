"""Run a study: one command for each claim of the paper.

python baselines/ablate.py --study main --budget 1_000_000 --seeds 3
python baselines/ablate.py --study main --dry_run          # what would be run, and about how long
python baselines/ablate.py --study all --report --results docs/results

Runs lie in runs/ablate/, one folder each, and studies share them. A study that was stopped goes on with the same command: what
is finished is skipped, what was broken is continued, what failed is tried again. A run that fails is marked, with its log, and
does not stop the others. At the end the study's rows are added to the CSV files of the results, and its page is written.
"""

from __future__ import annotations

import dataclasses
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro
from estimate import format_seconds, seconds_left
from launchers import Launcher, LocalLauncher, SlurmLauncher
from progress_table import ProgressTable, job_line
from study_jobs import RUNS, Job, first_error, make_expert_jobs, make_jobs

from maniskill_grpd.experiments import STUDIES, Study, find_study
from maniskill_grpd.experiments.pages import ALL, DATA_FOLDER, write_study_page, write_summary_page
from maniskill_grpd.experiments.results import save_runs
from maniskill_grpd.learning.options import parse_options, require_positive

POLL_SECONDS = 0.5
DEFAULT_BUDGET = 1_000_000


@dataclass(frozen=True, kw_only=True)
class AblateConfig:
    """Options of a study."""

    study: str
    """name of the study; with --report also "all" """
    budget: int | None = None
    """environment steps of each training, 1,000,000 by default; with --report those of the runs to show, by default the most"""
    seeds: int = 3
    """trainings of each policy on each task, with seeds from 1 up"""
    tasks: tuple[str, ...] = ()
    """only these tasks of the study"""
    arms: tuple[str, ...] = ()
    """only these policies (arms) of the study"""
    num_episodes: int = 100
    """episodes of each test"""
    train_options: tuple[str, ...] = ()
    """options of train.py for all trainings as key=value pairs, such as num_envs=1024 on a GPU; they make runs of their own,
    which --report finds by the same options"""

    launcher: Literal["local", "slurm"] = "local"
    """where jobs run: processes of this machine, or a Slurm cluster (needs submitit)"""
    jobs: int | None = None
    """jobs at a time; local: one per core, or one on a GPU, by default"""
    slurm: tuple[str, ...] = ()
    """what submitit asks Slurm for as key=value pairs: slurm_partition=gpu gpus_per_node=1 timeout_min=600"""

    dry_run: bool = False
    """list the runs and the estimated time, and stop"""
    report: bool = False
    """run nothing; write the pages from the CSV files of the results"""
    results: Path = RUNS / "results"
    """folder of the pages; its folder `data` holds the CSV files"""

    def __post_init__(self) -> None:
        given = [name for name in ("budget", "seeds", "num_episodes", "jobs") if getattr(self, name) is not None]
        require_positive(self, *given)
        parse_options("train_options", self.train_options)
        parse_options("slurm", self.slurm)

    @property
    def studies(self) -> list[Study]:
        """The studies meant, with the options of training that were given.

        Raises:
            ValueError: If there is no such study, listing those there are.
        """
        studies = STUDIES.values() if self.study == ALL and self.report else [find_study(self.study)]
        given = parse_options("train_options", self.train_options)
        return [dataclasses.replace(study, train_options={**study.train_options, **given}) for study in studies]


def ablate(config: AblateConfig) -> int:
    """Run a study, or only list it, or only write its page.

    Returns:
        The number of runs that failed.

    Raises:
        ValueError: If there is no such study, task or arm, or no checkpoint to test.
        KeyboardInterrupt: If stopped.
    """
    studies = config.studies
    if config.report:
        write_pages(config, studies)
        return 0
    (study,) = studies
    jobs = plan(config, study)
    if config.dry_run:
        list_jobs(jobs, config)
        return 0
    try:
        execute(jobs, make_launcher(config))
    finally:
        ended = [job for job in jobs if job.is_trained or job.failure.exists()]
        rows = [(job.run.name, job.folder, "finished" if job.is_trained else "failed") for job in ended]
        save_runs(config.results / DATA_FOLDER, rows)
    write_pages(config, studies)
    failed = [job for job in jobs if job.state == "failed"]
    for job in failed:
        print(f"failed: {job.run.name}: {first_error(job)} (log: {job.log})", file=sys.stderr)
    return len(failed)


def plan(config: AblateConfig, study: Study) -> list[Job]:
    """Return the jobs of a study, experts included; where it tests checkpoints of another, those whose checkpoints are there.

    Raises:
        ValueError: If there are none, listing the checkpoints there are.
    """
    restricted = study.restricted(config.tasks, config.arms)
    jobs = make_jobs(restricted, config.budget or DEFAULT_BUDGET, range(1, config.seeds + 1), config.num_episodes)
    ready = [job for job in jobs if job.trains or job.is_trained]
    if not ready:
        found = sorted(path.parent.name for path in RUNS.glob("*/final_ckpt.pt"))
        raise ValueError(
            f"study {study.name!r} tests checkpoints of {study.trained_by!r}, and none of those it needs is in {RUNS}, such as "
            f"{jobs[0].run.name}; run --study {study.trained_by} first, or give its --budget. "
            f"There are: {', '.join(found) or 'none'}"
        )
    if len(ready) < len(jobs):
        print(f"{len(jobs) - len(ready)} of {len(jobs)} checkpoints are not there yet; the others are tested")
    return [*ready, *make_expert_jobs(restricted, config.num_episodes)]


def list_jobs(jobs: Sequence[Job], config: AblateConfig) -> None:
    """Print the jobs, how far they are and how long they may take."""
    for job in jobs:
        print(job_line(job))
    num_jobs = config.jobs or (LocalLauncher().num_jobs if config.launcher == "local" else len(jobs))
    left = format_seconds(seconds_left(jobs, num_jobs))
    num_experts = sum(job.is_expert for job in jobs)
    num_tests = sum(len(job.conditions) for job in jobs)
    print(
        f"{len(jobs) - num_experts} runs and {num_experts} experts with {num_tests} tests, {num_jobs} at a time: roughly {left}"
    )


def make_launcher(config: AblateConfig) -> Launcher:
    """Make the launcher that was asked for."""
    if config.launcher == "slurm":
        return SlurmLauncher(config.jobs, parse_options("slurm", config.slurm))
    return LocalLauncher(config.jobs)


def execute(jobs: Sequence[Job], launcher: Launcher) -> None:
    """Run the jobs that are not finished, showing how far they are, until all have ended.

    Raises:
        KeyboardInterrupt: If stopped; jobs have ended by then.
    """
    table = ProgressTable(jobs, launcher.num_jobs)
    pending = [job for job in jobs if job.state != "finished"]
    for job in pending:
        job.failure.unlink(missing_ok=True)
    launcher.launch(pending)
    try:
        while not launcher.is_done():
            table.show(launcher.running())
            time.sleep(POLL_SECONDS)
    except BaseException:
        launcher.stop()
        raise
    table.show([], now=True)


def write_pages(config: AblateConfig, studies: Sequence[Study]) -> None:
    """Write the pages of studies and the summary."""
    for study in studies:
        print(f"page: {write_study_page(study, config.results, config.budget)}")
    print(f"page: {write_summary_page(config.results)}")


def main(arguments: Sequence[str]) -> int:
    """Run a study; report what the user can mend in one line instead of a traceback."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        return 1 if ablate(tyro.cli(AblateConfig, args=list(arguments), description=__doc__)) else 0
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on", file=sys.stderr)
        return 130


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
