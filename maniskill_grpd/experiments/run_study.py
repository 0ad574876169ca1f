"""Run a study: plan its jobs, run them, save what came out and write its page."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from maniskill_grpd.experiments.fingerprints import Present
from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.launchers import LauncherConfig
from maniskill_grpd.experiments.pages import ALL, DATA_FOLDER, write_study_page, write_summary_page
from maniskill_grpd.experiments.results import load_results, save_runs
from maniskill_grpd.experiments.runner import list_jobs, run_jobs
from maniskill_grpd.experiments.studies import STUDIES, find_study
from maniskill_grpd.experiments.study import Study
from maniskill_grpd.experiments.study_jobs import STUDY_RUNS, plan_study
from maniskill_grpd.learning.options import parse_options, require_positive

DEFAULT_BUDGET = 1_000_000
RESULTS = STUDY_RUNS / "results"
"""Folder of pages and CSV files, unless another is given."""
SMOKE_RESULTS = STUDY_RUNS / "smoke"
"""The same for smoke tests, which have no results."""
SMOKE_OPTIONS = {"num_envs": 4, "num_steps": 20, "num_minibatches": 2, "update_epochs": 1, "num_eval_envs": 2}
SMOKE_BUDGET, SMOKE_EPISODES = 160, 4
"""Steps of each training of a smoke test, two iterations, and episodes of each of its tests."""


@dataclass(frozen=True, kw_only=True)
class StudyConfig(LauncherConfig):
    """Options of a study."""

    study: str
    """name of the study; with --report also "all" """
    budget: int | None = None
    """environment steps of each training, 1,000,000 by default; with --report those of the runs to show, by default the most"""
    seeds: int = 3
    """trainings of each arm on each task, with seeds from 1 up (of studies that tune from 1001 up)"""
    tasks: tuple[str, ...] = ()
    """only these tasks of the study"""
    own_tasks: tuple[str, ...] = ()
    """further tasks for the studies of all tasks, of the form module:id, which runs the code of that module"""
    arms: tuple[str, ...] = ()
    """only these policies (arms) of the study"""
    num_episodes: int = 100
    """episodes of each test"""
    train_options: tuple[str, ...] = ()
    """options of `train` for all trainings as key=value pairs, such as num_envs=1024 on a GPU; they make runs of their own,
    which --report finds by the same options"""
    quick: bool = False
    """smoke test: every arm end to end in minutes, one seed, two iterations; its page says so and lies in a folder of its own"""
    report: bool = False
    """run nothing; write the pages from the CSV files of the results"""
    output: Path | None = None
    """folder of the pages, by default runs/ablate/results; its folder `data` holds the CSV files"""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, *(("seeds", "num_episodes") if self.budget is None else ("budget", "seeds", "num_episodes")))
        parse_options("train_options", self.train_options)
        own = [name for name in ("budget", "output", "train_options") if getattr(self, name)]
        if self.quick and own:
            raise ValueError(f"--quick has a {' and '.join(own)} of its own; leave out --{' --'.join(own)}")

    @property
    def folder(self) -> Path:
        """Where pages and data go."""
        return self.output or (SMOKE_RESULTS if self.quick else RESULTS)

    @property
    def studies(self) -> list[Study]:
        """The studies meant, with the options of training that were given.

        Raises:
            ValueError: If there is no such study, listing those there are.
        """
        studies = STUDIES.values() if self.study == ALL and self.report else [find_study(self.study)]
        if self.quick:
            return [as_smoke_test(study) for study in studies]
        given = parse_options("train_options", self.train_options)
        return [dataclasses.replace(study, train_options={**study.train_options, **given}) for study in studies]


def as_smoke_test(study: Study) -> Study:
    """Return a study that shows no more than that every arm runs to the end."""
    question = (
        f"**Smoke test, no result**: every arm was trained for {SMOKE_BUDGET} steps and tested in {SMOKE_EPISODES} episodes, to "
        f"see that it runs. Its figures mean nothing. {study.question}"
    )
    return dataclasses.replace(
        study,
        title=f"{study.title} (smoke test)",
        question=question,
        claims=(),
        budget=SMOKE_BUDGET,
        train_options={**study.train_options, **SMOKE_OPTIONS},
        is_smoke_test=True,
    )


def run_study(config: StudyConfig, present: Present | None = None) -> list[Job]:
    """Run a study, or only list it, or only write its page.

    Args:
        config: Options.
        present: What the present code says of a run; see `choose`.

    Returns:
        The jobs that failed.

    Raises:
        ValueError: If there is no such study, task or arm, or no checkpoint to test.
        KeyboardInterrupt: If interrupted; what has ended is saved.
    """
    studies = config.studies
    failed: list[Job] = []
    if not config.report:
        (study,) = studies
        study = study.restricted(config.tasks, config.arms)
        num_seeds, num_episodes = (1, SMOKE_EPISODES) if config.quick else (config.seeds, config.num_episodes)
        jobs = plan_study(study, config.budget or DEFAULT_BUDGET, study.seeds(num_seeds), num_episodes)
        if config.dry_run:
            list_jobs(jobs, config)
            return []
        load_results(config.folder / DATA_FOLDER)  # damaged files are refused before hours of work, not after
        try:
            failed = run_jobs(jobs, config, STUDY_RUNS)
        finally:
            save_jobs(jobs, config.folder / DATA_FOLDER)
    write_pages(config, studies, present)
    return failed


def save_jobs(jobs: Sequence[Job], folder: Path) -> None:
    """Add the runs that have been trained, or have failed, to the CSV files of a folder."""
    ended = [job for job in jobs if job.is_trained or job.failure.exists()]
    save_runs(folder, [(job.name, job.folder, "finished" if job.is_trained else "failed") for job in ended])


def write_pages(config: StudyConfig, studies: Sequence[Study], present: Present | None) -> None:
    """Write the pages of studies and, of results, the summary."""
    for study in studies:
        print(f"page: {write_study_page(study, config.folder, config.budget, present)}")
    if not config.quick:
        print(f"page: {write_summary_page(config.folder, present=present)}")
