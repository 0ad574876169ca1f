"""The jobs of a study: its trainings with their tests, and the experts that are played beside them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from maniskill_grpd.experiments.job import Job, Tests
from maniskill_grpd.experiments.records import TEST_FOLDER
from maniskill_grpd.experiments.study import AS_TRAINED, Run, Study, Task, expert_run, to_pairs
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.runs.folder import RUNS

STUDY_RUNS = RUNS / "ablate"
"""Folder of the runs of all studies, which share them."""


def plan_study(study: Study, budget: int, seeds: Sequence[int], num_episodes: int) -> list[Job]:
    """Return the jobs of a study, experts last; where it tests checkpoints of another, those whose checkpoints are there.

    Args:
        study: The study.
        budget: Environment steps of each training, unless the study fixes them.
        seeds: Those of the trainings.
        num_episodes: Episodes of each test.

    Raises:
        ValueError: If a run has options that its policy or the trainer does not know, or is there with other options; if there
            is no checkpoint to test, listing those there are.
    """
    jobs = [make_job(study, run, num_episodes) for run in study.runs(budget, seeds)]
    ready = [job for job in jobs if study.trained_by is None or job.is_trained]
    if not ready:
        found = sorted(path.parent.name for path in STUDY_RUNS.glob("*/final_ckpt.pt"))
        raise ValueError(
            f"study {study.name!r} tests checkpoints of {study.trained_by!r}, and none of those it needs is in {STUDY_RUNS}, "
            f"such as {jobs[0].name}; run --study {study.trained_by} first, or give its --budget. "
            f"There are: {', '.join(found) or 'none'}"
        )
    if len(ready) < len(jobs):
        print(f"{len(jobs) - len(ready)} of {len(jobs)} checkpoints are not there yet; the others are tested")
    return [*ready, *(make_expert_job(task, num_episodes) for task in study.tasks if task.conditions)]


def make_job(study: Study, run: Run, num_episodes: int) -> Job:
    """Return the job of one run: its training, and the tests under the conditions of the study.

    Raises:
        ValueError: If an option is not known or not valid, or the folder holds something else.
    """
    training = Training(dataclasses.replace(run.train_config(), exp_name=f"{STUDY_RUNS.name}/{run.name}"))
    options = ("--study", study.name, "--checkpoint", str(training.checkpoint), "--num_episodes", str(num_episodes))
    if ":" in run.task.env_id:
        options += ("--own_tasks", run.task.env_id)
    names = tuple(condition.name for condition in run.task.conditions)
    job = Job(training.folder, training, Tests(training.folder, ("evaluate_study", *options), names, num_episodes))
    job.check()
    return job


def make_expert_job(task: Task, num_episodes: int) -> Job:
    """Return the job that plays the expert of a task, as policies are tested in the first place."""
    folder = STUDY_RUNS / expert_run(task).name
    result = folder / TEST_FOLDER / f"{AS_TRAINED.name}.json"
    options = ("--env_id", task.env_id, "--env_kwargs", *to_pairs({**task.options, "num_threads": 1}))
    words = ("evaluate_expert", *options, "--json", str(result), "--num_episodes", str(num_episodes))
    return Job(folder, tests=Tests(folder, words, (AS_TRAINED.name,), num_episodes))
