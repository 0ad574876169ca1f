"""How long a study will take."""

from __future__ import annotations

from collections.abc import Iterable

from study_jobs import Job

from maniskill_grpd.learning.run_log import read_rows

STEPS_PER_SECOND = {"grpd": 430.0, "empn": 150.0, "hetero_gnn": 470.0, "transformer": 245.0}
"""Environment steps per second, by policy: RopeShaping-v1, `REFERENCE_NODES` nodes seen, one of two busy cores of an AMD EPYC
without AVX-512; used until a training of the kind has begun."""
REFERENCE_NODES = 21
START_SECONDS = 11.0
"""Start of a training or of tests."""
TEST_SECONDS = 0.1
"""An episode of a test."""


def seconds_left(jobs: Iterable[Job], num_jobs: int) -> float:
    """Return an estimate of the time until all jobs are finished [s].

    The speed of a training is its own if it has begun, that of another one of the same task and policy in the list, or else a
    rough guess from the number of nodes that the policy sees.

    Args:
        jobs: All jobs of the study.
        num_jobs: Jobs that run at a time.
    """
    jobs = list(jobs)
    measured = {_kind(job): rate for job in jobs if (rate := measured_rate(job)) is not None}
    return sum(_seconds_left(job, measured.get(_kind(job))) for job in jobs) / num_jobs


def _seconds_left(job: Job, rate: float | None) -> float:
    if job.state in ("finished", "failed"):
        return 0.0
    seconds = START_SECONDS + TEST_SECONDS * job.num_episodes * len(job.conditions)
    if not job.is_trained:
        seconds += START_SECONDS + (job.run.budget - job.steps) / (measured_rate(job) or rate or guessed_rate(job))
    return seconds


def measured_rate(job: Job) -> float | None:
    """Return environment steps per second of a training that has begun, evaluations included; None if it has not."""
    metrics = job.folder / "metrics.jsonl"
    rows = read_rows(metrics, "train")
    if not rows:
        return None
    seconds = sum(row["time/rollout_time"] + row["time/update_time"] for row in rows)
    seconds += sum(row["time/eval_time"] for row in read_rows(metrics, "eval"))
    return len(rows) * job.run.train_config().batch_size / seconds


def guessed_rate(job: Job) -> float:
    """Return environment steps per second as far as policy and number of nodes tell."""
    options = job.run.task.options
    nodes = options.get("graph_nodes") or options.get("resolution") or REFERENCE_NODES
    epochs = job.run.train_config().update_epochs / 5
    return STEPS_PER_SECOND[job.run.arm.policy] * (REFERENCE_NODES / nodes) / epochs


def format_seconds(seconds: float) -> str:
    """Return a time such as 1:05:09."""
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{rest:02d}"


def _kind(job: Job) -> tuple[str, str]:
    return job.run.name.split("__")[0], job.run.name.split("__")[1]
