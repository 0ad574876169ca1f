"""How long jobs will take."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping

from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.learning.run_log import read_rows

STEPS_PER_SECOND = {"grpd": 430.0, "empn": 150.0, "hetero_gnn": 470.0, "transformer": 245.0}
"""Environment steps per second, by policy: RopeShaping-v1, `REFERENCE_NODES` nodes seen, one of two busy cores of an AMD EPYC
without AVX-512; used until a training of the kind has begun."""
REFERENCE_NODES = 21
REFERENCE_EPOCHS = 5
START_SECONDS = 11.0
"""Start of a training or of tests."""
TEST_SECONDS = 0.1
"""An episode of a test."""


def seconds_left(jobs: Iterable[Job], num_jobs: int) -> float:
    """Return an estimate of the time until all jobs are finished [s].

    The speed of a training is its own if it has begun, that of another one of the same task and policy in the list, or else a
    rough guess from the number of nodes that the policy sees.

    Args:
        jobs: All jobs.
        num_jobs: Jobs that run at a time.
    """
    jobs = list(jobs)
    trainings = [job.training for job in jobs if job.training is not None]
    measured = {_kind(training): rate for training in trainings if (rate := measured_rate(training)) is not None}
    return sum(_seconds_left(job, measured) for job in jobs) / num_jobs


def _seconds_left(job: Job, measured: Mapping[Hashable, float]) -> float:
    if job.state in ("finished", "failed"):
        return 0.0
    seconds = 0.0
    if job.training is not None and not job.is_trained:
        rate = measured_rate(job.training) or measured.get(_kind(job.training)) or guessed_rate(job.training)
        seconds += START_SECONDS + (job.total - job.steps) / rate
    if job.tests is not None:
        seconds += START_SECONDS + TEST_SECONDS * job.tests.num_episodes * len(job.tests.conditions)
    return seconds


def measured_rate(training: Training) -> float | None:
    """Return environment steps per second of a training that has begun, evaluations included; None if it has not."""
    metrics = training.folder / "metrics.jsonl"
    rows = read_rows(metrics, "train")
    if not rows:
        return None
    seconds = sum(row["time/rollout_time"] + row["time/update_time"] for row in rows)
    seconds += sum(row["time/eval_time"] for row in read_rows(metrics, "eval"))
    return len(rows) * training.config.batch_size / seconds


def guessed_rate(training: Training) -> float:
    """Return environment steps per second as far as policy and number of nodes tell.

    A policy that has not been measured is taken for as slow as the slowest that has.
    """
    config = training.config
    nodes = config.env_options.get("graph_nodes") or config.env_options.get("resolution") or REFERENCE_NODES
    rate = STEPS_PER_SECOND.get(config.policy, min(STEPS_PER_SECOND.values()))
    return rate * (REFERENCE_NODES / nodes) / (config.update_epochs / REFERENCE_EPOCHS)


def format_seconds(seconds: float) -> str:
    """Return a time such as 1:05:09."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def _kind(training: Training) -> Hashable:
    config = training.config
    return config.env_id, config.env_kwargs, config.policy, config.policy_kwargs
