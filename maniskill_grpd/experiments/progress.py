"""The live table of jobs."""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import TextIO

from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.time_left import format_seconds, measured_rate, seconds_left
from maniskill_grpd.learning.run_log import read_rows

REFRESH_SECONDS = 2.0
"""Between two pictures on a terminal."""
LOG_SECONDS = 60.0
"""Between two lines where the output goes to a file."""
SCORES = {"return": "train/return", "success": "train/success_once", "evaluated": "eval/success_at_end"}
"""Scores of a training that are shown, and the tags of its log that they are."""


class ProgressTable:
    """Shows how far the jobs are: on a terminal a table that is redrawn, in a file one line from time to time.

    Args:
        jobs: All jobs.
        num_jobs: Jobs that run at a time.
        stream: Where it goes.
    """

    def __init__(self, jobs: Sequence[Job], num_jobs: int, stream: TextIO | None = None) -> None:
        self._jobs = jobs
        self._num_jobs = num_jobs
        self._stream = stream or sys.stdout
        self._num_lines = 0
        self._next = 0.0

    def show(self, running: Sequence[Job], now: bool = False) -> None:
        """Draw the table if it is time to.

        Args:
            running: Jobs at work.
            now: Draw it in any case.
        """
        is_terminal = self._stream.isatty()
        if not now and time.monotonic() < self._next:
            return
        self._next = time.monotonic() + (REFRESH_SECONDS if is_terminal else LOG_SECONDS)
        lines = [self._summary(running), *(job_line(job) for job in running)]
        if is_terminal:
            self._stream.write(f"\033[{self._num_lines}F\033[J" if self._num_lines else "")
            self._num_lines = len(lines)
        self._stream.write("\n".join(lines if is_terminal else lines[:1]) + "\n")
        self._stream.flush()

    def _summary(self, running: Sequence[Job]) -> str:
        states = Counter(job.state for job in self._jobs)
        waiting = len(self._jobs) - states["finished"] - states["failed"] - len(running)
        left = format_seconds(seconds_left(self._jobs, self._num_jobs))
        return (
            f"{states['finished']} of {len(self._jobs)} finished, {len(running)} running, {max(0, waiting)} waiting, "
            f"{states['failed']} failed; about {left} left"
        )


def job_line(job: Job) -> str:
    """Return one line: name, state, steps, speed, latest scores."""
    line = f"  {job.name:<80} {job.state:<9} {job.steps:>11,} of {job.total:<11,}"
    rate = None if job.training is None else measured_rate(job.training)
    if rate is None:
        return line
    last = {tag: value for row in read_rows(job.folder / "metrics.jsonl") for tag, value in row.items()}
    scores = [f"{name} {last[tag]:.3g}" for name, tag in SCORES.items() if tag in last]
    return "  ".join([f"{line}{rate:8,.0f} steps/s", *scores])
