"""Where jobs run: a pool of processes on this machine, or a Slurm cluster."""

from __future__ import annotations

import os
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch

from maniskill_grpd.experiments.job import Job, run_job
from maniskill_grpd.extras import import_extra
from maniskill_grpd.learning.options import parse_options, require_positive

SLURM_DEFAULTS = {"timeout_min": 24 * 60, "cpus_per_task": 2, "name": "maniskill_grpd"}
"""What is asked for unless the command line says otherwise."""
SLURM_JOBS = 64
"""Most jobs of an array at a time, unless the command line says otherwise."""


class Launcher(ABC):
    """Runs jobs, several at a time."""

    num_jobs: int
    """Jobs that run at a time, for estimates."""

    @abstractmethod
    def launch(self, jobs: Sequence[Job]) -> None:
        """Begin with the jobs, in their order; returns at once."""

    @abstractmethod
    def running(self) -> list[Job]:
        """Return the jobs that are at work."""

    @abstractmethod
    def is_done(self) -> bool:
        """Return whether all jobs have ended, well or not."""

    @abstractmethod
    def stop(self) -> None:
        """Ask all jobs to end; what they have saved stays."""


class LocalLauncher(Launcher):
    """Runs jobs in processes of this machine, each with one thread.

    Args:
        num_jobs: Jobs at a time; by default one per core, or one if there is a GPU, which they would share.
    """

    def __init__(self, num_jobs: int | None = None) -> None:
        self.num_jobs = num_jobs or default_num_jobs()
        self._pool = ThreadPoolExecutor(self.num_jobs)
        self._futures: list[tuple[Job, Future[None]]] = []
        self._processes: list[subprocess.Popen[bytes]] = []
        self._is_stopping = False

    def launch(self, jobs: Sequence[Job]) -> None:
        """See `Launcher`."""
        self._futures = [(job, self._pool.submit(run_job, job, self._start, lambda: self._is_stopping)) for job in jobs]

    def running(self) -> list[Job]:
        """See `Launcher`."""
        return [job for job, future in self._futures if future.running()]

    def is_done(self) -> bool:
        """See `Launcher`."""
        for _, future in self._futures:
            if future.done():
                future.result()  # an error of this program, not of a run, must not be lost
        return all(future.done() for _, future in self._futures)

    def stop(self) -> None:
        """See `Launcher`."""
        self._is_stopping = True
        self._pool.shutdown(wait=False, cancel_futures=True)
        for process in self._processes:
            process.terminate()
        self._pool.shutdown(wait=True)

    def _start(self, command: Sequence[str], **settings: Any) -> subprocess.Popen[bytes]:
        """Start a process with one thread, and remember it."""
        process = subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, **settings)
        self._processes.append(process)
        if self._is_stopping:
            process.terminate()
        return process


@dataclass(frozen=True)
class Submission:
    """What Slurm runs: a job, queued again when it is preempted or out of time."""

    job: Job

    def __call__(self) -> None:
        """Run the job."""
        run_job(self.job)

    def checkpoint(self) -> Any:
        """Return the submission that goes on (submitit calls this before the time is over)."""
        from submitit.helpers import DelayedSubmission

        return DelayedSubmission(self)


class SlurmLauncher(Launcher):
    """Submits jobs to Slurm as one array; needs the package submitit.

    Args:
        folder: For the logs of submitit and the jobs it hands over.
        num_jobs: Most jobs of the array at a time.
        parameters: What submitit asks Slurm for, such as {"slurm_partition": "gpu", "gpus_per_node": 1}.
        cluster: Submitit's name of the cluster; "local" tries a submission without one.

    Raises:
        MissingExtraError: Without submitit.
        ValueError: If there is no Slurm here, or a parameter is not known.
    """

    def __init__(
        self, folder: Path, num_jobs: int | None = None, parameters: Mapping[str, Any] | None = None, cluster: str = "slurm"
    ) -> None:
        submitit = import_extra("submitit", "sweep", "--launcher slurm")
        self.num_jobs = num_jobs or SLURM_JOBS
        try:
            self._executor = submitit.AutoExecutor(folder.absolute(), cluster=cluster)
            array = {"slurm_array_parallelism": self.num_jobs}
            self._executor.update_parameters(**{**SLURM_DEFAULTS, **array, **(parameters or {})})
        except RuntimeError as error:
            raise ValueError(f"--launcher slurm: {error}") from error
        except NameError as error:
            raise ValueError(f"--slurm: {error}") from error
        self._submitted: list[tuple[Job, Any]] = []

    def launch(self, jobs: Sequence[Job]) -> None:
        """See `Launcher`."""
        with self._executor.batch():
            self._submitted = [(job, self._executor.submit(Submission(job))) for job in jobs]

    def running(self) -> list[Job]:
        """See `Launcher`."""
        return [job for job, submitted in self._submitted if submitted.state == "RUNNING"]

    def is_done(self) -> bool:
        """See `Launcher`."""
        return all(submitted.done() for _, submitted in self._submitted)

    def stop(self) -> None:
        """See `Launcher`."""
        for _, submitted in self._submitted:
            submitted.cancel()


@dataclass(frozen=True, kw_only=True)
class LauncherConfig:
    """Options of studies and sweeps alike: where their jobs run, and how many at a time."""

    launcher: Literal["local", "slurm"] = "local"
    """where jobs run: processes of this machine, or a Slurm cluster (needs submitit)"""
    jobs: int | None = None
    """jobs at a time; local: one per core, or one on a GPU, by default"""
    slurm: tuple[str, ...] = ()
    """what submitit asks Slurm for as key=value pairs: slurm_partition=gpu gpus_per_node=1 timeout_min=600"""
    dry_run: bool = False
    """list the runs and the estimated time, and stop"""

    def __post_init__(self) -> None:
        if self.jobs is not None:
            require_positive(self, "jobs")
        parse_options("slurm", self.slurm)

    def make_launcher(self, folder: Path) -> Launcher:
        """Make the launcher that was asked for; `folder` takes what Slurm writes."""
        if self.launcher == "slurm":
            return SlurmLauncher(folder / ".slurm", self.jobs, parse_options("slurm", self.slurm))
        return LocalLauncher(self.jobs)

    def num_jobs(self, num_all: int) -> int:
        """Return how many of `num_all` jobs run at a time, for an estimate before a launcher is made."""
        return self.jobs or (default_num_jobs() if self.launcher == "local" else min(num_all, SLURM_JOBS))


def default_num_jobs() -> int:
    """Return the number of jobs that this machine runs at a time: one per core, or one if there is a GPU."""
    return 1 if torch.cuda.is_available() else os.cpu_count() or 1
