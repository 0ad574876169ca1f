"""The one place where jobs are run: what is finished is skipped, what was interrupted goes on, and how far they are is shown."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.launchers import LauncherConfig
from maniskill_grpd.experiments.progress import ProgressTable, job_line
from maniskill_grpd.experiments.time_left import format_seconds, seconds_left
from maniskill_grpd.runs.stop_request import SIGNALS

POLL_SECONDS = 0.5


def run_jobs(jobs: Sequence[Job], config: LauncherConfig, folder: Path) -> list[Job]:
    """Run the jobs that are not finished until all have ended; a failed one is tried again and does not stop the others.

    Args:
        jobs: All jobs; each knows from its folder how far it is.
        config: Where they run, and how many at a time.
        folder: For what a launcher writes.

    Returns:
        The jobs that failed; each has been named on stderr, with the error and the log.

    Raises:
        ValueError: If the launcher cannot be had.
        KeyboardInterrupt: If interrupted, or asked to terminate; jobs have ended by then, and the same call goes on.
    """
    launcher = config.make_launcher(folder)
    table = ProgressTable(jobs, launcher.num_jobs)
    pending = [job for job in jobs if job.state != "finished"]
    for job in pending:
        job.failure.unlink(missing_ok=True)
    with _signals_as_interrupt():
        launcher.launch(pending)
        try:
            while not launcher.is_done():
                table.show(launcher.running())
                time.sleep(POLL_SECONDS)
        except BaseException:
            print("stopping: trainings end with their iteration, and leave a checkpoint", file=sys.stderr)
            launcher.stop()
            raise
    table.show([], now=True)
    failed = [job for job in jobs if job.state == "failed"]
    for job in failed:
        print(f"failed: {job.name}: {job.first_error()} (log: {job.log})", file=sys.stderr)
    return failed


def list_jobs(jobs: Sequence[Job], config: LauncherConfig) -> None:
    """Print the jobs, how far they are and how long they may take; what --dry_run does."""
    for job in jobs:
        print(job_line(job))
    num_jobs = config.num_jobs(len(jobs))
    experts = sum(job.training is None for job in jobs)
    tests = sum(len(job.tests.conditions) for job in jobs if job.tests is not None)
    left = format_seconds(seconds_left(jobs, num_jobs))
    print(f"{len(jobs) - experts} runs and {experts} experts with {tests} tests, {num_jobs} at a time: roughly {left}")


@contextlib.contextmanager
def _signals_as_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP stop the jobs as Ctrl-C does."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if before[number] != signal.SIG_IGN:
            signal.signal(number, _interrupt)
    try:
        yield
    finally:
        for number in SIGNALS:
            signal.signal(number, before[number])


def _interrupt(*_: Any) -> None:
    raise KeyboardInterrupt
