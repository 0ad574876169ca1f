"""A job: commands that run one after another and leave everything in one folder, which tells how far it is."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from maniskill_grpd.experiments.records import TEST_FOLDER, is_played
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.program import command_line, process_arguments
from maniskill_grpd.runs.file_lock import try_lock
from maniskill_grpd.runs.stop_request import SIGNALS

LOCK_FOLDER = ".locks"
"""Folder of the locks, beside the folders of jobs."""
LOCK_POLL_SECONDS = 0.2
"""How often a job looks whether the process that works in its folder is done."""
INTERRUPTED = {code for number in SIGNALS for code in (128 + number, -number)}
"""Return codes of a command that was asked to stop, which is no failure."""

State = Literal["waiting", "training", "testing", "finished", "failed"]
Start = Callable[..., "subprocess.Popen[bytes]"]


@dataclass(frozen=True)
class Tests:
    """The command that tests a run.

    Attributes:
        folder: Folder of the run.
        words: The command.
        conditions: Names of the tests, each of which leaves a file.
        num_episodes: Episodes of each test.
    """

    folder: Path
    words: tuple[str, ...]
    conditions: tuple[str, ...]
    num_episodes: int

    doing = "testing"
    num_processes = 1
    __test__ = False  # no class of tests of this package itself

    def has_begun(self) -> bool:
        """Return whether a test has been done."""
        return (self.folder / TEST_FOLDER).exists()

    def is_done(self) -> bool:
        """Return whether every test has been done, with as many episodes."""
        plan = {"num_episodes": self.num_episodes}
        return all(is_played(self.folder / TEST_FOLDER / f"{name}.json", plan) for name in self.conditions)

    def prepare(self) -> None:
        """Tests that were interrupted need no preparation: those whose files are there are left out."""


@dataclass(frozen=True)
class Job:
    """A training, tests, or both, training first.

    Attributes:
        folder: Where everything goes, the log and the mark of a failure included.
        training: Trains the run; None for an expert.
        tests: Test what has been trained; None if nothing is to be tested.
    """

    folder: Path
    training: Training | None = None
    tests: Tests | None = None

    @property
    def name(self) -> str:
        """Name of its folder."""
        return self.folder.name

    @property
    def commands(self) -> tuple[Training | Tests, ...]:
        """What it runs, in order."""
        return tuple(command for command in (self.training, self.tests) if command is not None)

    @property
    def failure(self) -> Path:
        """What a failed job leaves: which of its commands failed, and how."""
        return self.folder / "failed.json"

    @property
    def log(self) -> Path:
        """What the commands print."""
        return self.folder / "job.log"

    @property
    def is_trained(self) -> bool:
        """Whether the training is done; that of an expert always is."""
        return self.training is None or self.training.is_done()

    @property
    def state(self) -> State:
        """How far it is, as its folder tells; "waiting" also while another job has its place."""
        left = [command for command in self.commands if not command.is_done()]
        if not left:
            return "finished"
        if self.failure.exists():
            return "failed"
        return left[0].doing if left[0].has_begun() or len(left) < len(self.commands) else "waiting"

    @property
    def steps(self) -> int:
        """Environment steps trained so far."""
        return 0 if self.training is None else self.training.steps

    @property
    def total(self) -> int:
        """Environment steps of the training."""
        return 0 if self.training is None else self.training.total

    def check(self) -> None:
        """Refuse a folder that holds something else than this job, before anything is started.

        Raises:
            ValueError: Saying what it holds.
        """
        if self.training is not None:
            self.training.check()
        own = {TEST_FOLDER, self.log.name, self.failure.name}
        names = sorted(path.name for path in self.folder.glob("*"))
        foreign = [name for name in names if name not in own and not name.startswith(".")]
        if foreign and not (self.is_trained or self.training.has_begun()):
            raise ValueError(f"{self.folder} is not the folder of a run but holds {', '.join(foreign)}; move it away")

    def first_error(self) -> str:
        """Return the last line of its log that names an error, or else its last line."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").splitlines() if self.log.exists() else []
        errors = [line for line in lines if "rror" in line]
        return (errors or lines or ["no log"])[-1].strip()


def run_job(job: Job, start: Start = subprocess.Popen, is_stopping: Callable[[], bool] = lambda: False) -> None:
    """Run the commands of a job that are not done; a failure is written to its folder.

    A job that another process works at is waited for, so that studies and sweeps may share runs.

    Args:
        job: The job.
        start: Starts a process, as `subprocess.Popen` does.
        is_stopping: Whether all jobs are asked to stop: another process is not waited for then, and no code is a failure.
    """
    with hold_lock(job, is_stopping) as lock:
        if lock is None:
            return
        for command in job.commands:
            if not command.is_done():
                command.prepare()
                code = _run_command(job, command.words, command.num_processes, start, lock)
                # PyTorch's launcher has one code for all that ends its processes, a stop included.
                if code != 0 and code not in INTERRUPTED and not is_stopping():
                    failure = {"command": command.words[0], "code": code, "log": str(job.log)}
                    job.failure.write_text(json.dumps(failure) + "\n", encoding="utf-8")
                if code != 0:
                    return


def _run_command(job: Job, words: Sequence[str], num_processes: int, start: Start, lock: int) -> int:
    """Run a command, add what it prints to the log, and return its exit code."""
    job.folder.mkdir(parents=True, exist_ok=True)
    with job.log.open("ab") as log:
        log.write(f"\n$ {command_line(words)}\n".encode())
        log.flush()
        arguments = process_arguments(words, num_processes)
        # With the lock in its hands a command that outlives this process still keeps others away. Windows knows no such thing.
        inherited = {"pass_fds": (lock,)} if os.name == "posix" else {}
        return start(arguments, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, **inherited).wait()


@contextlib.contextmanager
def hold_lock(job: Job, is_stopping: Callable[[], bool] = lambda: False) -> Iterator[int | None]:
    """Wait until no other job works in a folder, then keep others away; yields the descriptor of the lock.

    The lock ends when every process that holds the descriptor has ended, however it ends. Yields None if `is_stopping` came
    true while another process held it.
    """
    folder = job.folder.parent / LOCK_FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / job.name).open("w") as file:
        while not try_lock(file.fileno()):
            if is_stopping():
                yield None
                return
            time.sleep(LOCK_POLL_SECONDS)
        yield file.fileno()
