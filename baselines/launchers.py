"""Where the jobs of a study run: a pool of processes on this machine, or a Slurm cluster."""

from __future__ import annotations

import os
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
from study_jobs import RUNS, SCRIPTS, Job, run_job


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
        self.num_jobs = num_jobs or (1 if torch.cuda.is_available() else os.cpu_count() or 1)
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
        """Start a script with one thread, and remember it."""
        process = subprocess.Popen(command, env={**os.environ, "OMP_NUM_THREADS": "1"}, **settings)
        self._processes.append(process)
        if self._is_stopping:
            process.terminate()
        return process


class SlurmLauncher(Launcher):
    """Submits jobs to Slurm as one array; needs the package submitit.

    Args:
        num_jobs: Most jobs of the array at a time.
        parameters: What submitit asks Slurm for, such as {"slurm_partition": "gpu", "gpus_per_node": 1}.

    Raises:
        ValueError: If submitit is not installed, or there is no Slurm here.
    """

    def __init__(self, num_jobs: int | None = None, parameters: Mapping[str, Any] | None = None) -> None:
        try:
            import submitit  # optional
        except ImportError as error:
            raise ValueError("--launcher slurm needs submitit: pip install submitit") from error
        # What is submitted names functions of this folder, which the other machines must find.
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [str(SCRIPTS), os.environ.get("PYTHONPATH")]))
        self.num_jobs = num_jobs or 64
        try:
            self._executor = submitit.AutoExecutor(Path.cwd() / RUNS / ".slurm", cluster="slurm")
        except RuntimeError as error:
            raise ValueError(f"--launcher slurm: {error}") from error
        defaults = {"timeout_min": 24 * 60, "cpus_per_task": 2, "name": "ablate"}
        self._executor.update_parameters(slurm_array_parallelism=self.num_jobs, **{**defaults, **(parameters or {})})
        self._submitted: list[tuple[Job, Any]] = []

    def launch(self, jobs: Sequence[Job]) -> None:
        """See `Launcher`."""
        self._submitted = list(zip(jobs, self._executor.map_array(run_job, jobs), strict=True))

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
