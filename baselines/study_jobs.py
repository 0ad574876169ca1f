"""The jobs of a study: train one run, test it, and know from its folder how far it is."""

from __future__ import annotations

import contextlib
import dataclasses
import fcntl
import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from evaluate_study import is_played

from maniskill_grpd.experiments import Run, Study
from maniskill_grpd.experiments.records import TEST_FOLDER
from maniskill_grpd.experiments.study import AS_TRAINED, EXPERT, expert_run, to_pairs
from maniskill_grpd.learning.config import RESUMABLE_FIELDS
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.runs.record import to_arguments

RUNS = Path("runs") / "ablate"
"""Folder of the runs of all studies; train.py puts them there because their names begin with "ablate/"."""
SCRIPTS = Path(__file__).parent
LOCK_POLL_SECONDS = 0.2
"""How often a job looks whether the process that works at its run is done."""
STOPPED = {130, -signal.SIGINT, -signal.SIGTERM}
"""Return codes of a script that was asked to stop, which is no failure."""

State = Literal["waiting", "training", "testing", "finished", "failed"]
Start = Callable[..., "subprocess.Popen[bytes]"]


@dataclass(frozen=True)
class Job:
    """A run and the tests a study makes of it.

    Attributes:
        run: The training.
        study: Name of the study.
        conditions: Names of its tests.
        num_episodes: Episodes of each test.
        trains: Whether the run may be trained; if not, its checkpoint must be there.
    """

    run: Run
    study: str
    conditions: tuple[str, ...]
    num_episodes: int
    trains: bool = True

    @property
    def is_expert(self) -> bool:
        """Whether the scripted expert acts."""
        return self.run.arm == EXPERT

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return RUNS / self.run.name

    @property
    def checkpoint(self) -> Path:
        """What a finished training leaves."""
        return self.folder / "final_ckpt.pt"

    @property
    def failure(self) -> Path:
        """What a failed job leaves: which of its scripts failed, and how."""
        return self.folder / "failed.json"

    @property
    def log(self) -> Path:
        """What the scripts print."""
        return self.folder / "job.log"

    @property
    def is_trained(self) -> bool:
        """Whether the training is done; that of an expert always is."""
        return self.is_expert or self.checkpoint.exists()

    @property
    def is_tested(self) -> bool:
        """Whether every test is done."""
        plan = {"num_episodes": self.num_episodes}
        return all(is_played(self.folder / TEST_FOLDER / f"{name}.json", plan) for name in self.conditions)

    @property
    def state(self) -> State:
        """How far it is, as its folder tells; "waiting" also while another job has its place."""
        if self.is_trained and self.is_tested:
            return "finished"
        if self.failure.exists():
            return "failed"
        if self.is_trained:
            return "testing"
        return "training" if (self.folder / "config.json").exists() else "waiting"

    @property
    def steps(self) -> int:
        """Environment steps trained so far."""
        if self.is_trained:
            return self.run.budget
        rows = read_rows(self.folder / "metrics.jsonl", "train")
        return rows[-1]["global_step"] if rows else 0


def make_jobs(study: Study, budget: int, seeds: Sequence[int], num_episodes: int) -> list[Job]:
    """Return the jobs of a study.

    Raises:
        ValueError: If a run has options that its policy or the trainer does not know, or is there with other options.
    """
    jobs = []
    for run in study.runs(budget, seeds):
        names = tuple(condition.name for condition in run.task.conditions)
        job = Job(run, study.name, names, num_episodes, trains=study.trained_by is None)
        check_options(job)
        jobs.append(job)
    return jobs


def make_expert_jobs(study: Study, num_episodes: int) -> list[Job]:
    """Return the jobs that play the experts of a study's tasks, as policies are tested in the first place."""
    tasks = [task for task in study.tasks if task.conditions]
    return [Job(expert_run(task), study.name, (AS_TRAINED.name,), num_episodes, trains=False) for task in tasks]


def check_options(job: Job) -> None:
    """Refuse a run whose folder holds one that was trained with other options.

    Raises:
        ValueError: Naming the options that differ.
    """
    wanted = job.run.train_config().to_dict()
    record = job.folder / "config.json"
    if not record.exists():
        return
    found = json.loads(record.read_text(encoding="utf-8"))["config"]
    names = sorted(wanted.keys() & found.keys() - RESUMABLE_FIELDS - {"exp_name", "sim_backend"})
    differences = [f"{name} was {found[name]}, is {wanted[name]}" for name in names if found[name] != wanted[name]]
    if differences:
        raise ValueError(f"{job.folder} was trained with other options ({'; '.join(differences)}); move it away")


def run_job(job: Job, start: Start = subprocess.Popen, is_stopping: Callable[[], bool] = lambda: False) -> None:
    """Train and test what has not been; a failure is written to the folder of the run.

    A job that another process works at is waited for, so that two studies may share runs.

    Args:
        job: The job.
        start: Starts a script, as `subprocess.Popen` does.
        is_stopping: Whether to give up waiting for the other process.
    """
    with hold_lock(job, is_stopping) as lock:
        if lock is None:
            return
        if not job.is_trained and job.trains and not run_script(job, "train.py", train_arguments(job), start, lock):
            return
        if job.is_trained and not job.is_tested:
            script, arguments = test_command(job)
            run_script(job, script, arguments, start, lock)


def run_script(job: Job, script: str, arguments: Sequence[str], start: Start, lock: int) -> bool:
    """Run a script of this folder, add what it prints to the log, and return whether it went well."""
    job.folder.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, str(SCRIPTS / script), *arguments]
    with job.log.open("ab") as log:
        log.write(f"\n$ python baselines/{script} {' '.join(arguments)}\n".encode())
        log.flush()
        # With the lock in its hands a script that outlives this process still keeps others away.
        code = start(command, stdout=log, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL, pass_fds=(lock,)).wait()
    if code != 0 and code not in STOPPED:
        job.failure.write_text(json.dumps({"script": script, "code": code, "log": str(job.log)}) + "\n", encoding="utf-8")
    return code == 0


def train_arguments(job: Job) -> list[str]:
    """Return the arguments that begin a training or go on with it."""
    if (job.folder / "last.pt").exists():
        return ["--resume", str(job.folder)]
    if (job.folder / "config.json").exists():  # stopped before its first checkpoint
        shutil.rmtree(job.folder)
        job.folder.mkdir()
    config = dataclasses.replace(job.run.train_config(), exp_name=f"{RUNS.name}/{job.run.name}")
    return to_arguments(config)


def test_command(job: Job) -> tuple[str, list[str]]:
    """Return script and arguments that test a run under the conditions of the study, or play the expert."""
    episodes = ["--num_episodes", str(job.num_episodes)]
    if job.is_expert:
        path = job.folder / TEST_FOLDER / f"{AS_TRAINED.name}.json"
        task = ["--env_id", job.run.task.env_id, "--env_kwargs", *to_pairs({**job.run.task.options, "num_threads": 1})]
        return "evaluate_expert.py", [*task, "--json", str(path), *episodes]
    return "evaluate_study.py", ["--study", job.study, "--checkpoint", str(job.checkpoint), *episodes]


def first_error(job: Job) -> str:
    """Return the last line of a job's log that names an error, or else its last line."""
    lines = job.log.read_text(encoding="utf-8", errors="replace").splitlines() if job.log.exists() else []
    errors = [line for line in lines if "rror" in line]
    return (errors or lines or ["no log"])[-1].strip()


@contextlib.contextmanager
def hold_lock(job: Job, is_stopping: Callable[[], bool] = lambda: False) -> Iterator[int | None]:
    """Wait until nobody else works at a run, then keep others away; yields the descriptor of the lock.

    The lock ends when every process that holds the descriptor has ended, however it ends. Yields None if `is_stopping` came
    true while another process held it.
    """
    folder = RUNS / ".locks"
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / job.run.name).open("w") as file:
        while not _try_lock(file.fileno()):
            if is_stopping():
                yield None
                return
            time.sleep(LOCK_POLL_SECONDS)
        yield file.fileno()


def _try_lock(descriptor: int) -> bool:
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
