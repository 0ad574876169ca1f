"""A job runs what is not done, one process at a time in a folder, and marks what fails."""

import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from maniskill_grpd.experiments.job import Job, Tests, hold_lock, run_job
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.learning import TrainConfig


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def toy_job(name="toy"):
    run = Training(TrainConfig(exp_name=f"s/{name}", num_envs=4, num_steps=5, num_minibatches=2, total_timesteps=40))
    return Job(run.folder, run, Tests(run.folder, ("evaluate_study",), ("as trained",), 3))


def starting(*codes):
    """Return a starter whose processes end with the given codes, and the commands they were started with."""
    commands, left = [], list(codes)

    def start(command, **settings):
        commands.append(command[3])
        code = left.pop(0)
        # A training that ends well leaves its last checkpoint.
        program = f"import pathlib, sys; {code} or pathlib.Path('runs/s/toy/final_ckpt.pt').touch(); sys.exit({code})"
        return subprocess.Popen([sys.executable, "-c", program], **settings)

    return start, commands


def test_training_comes_first_and_tests_follow_it():
    job = toy_job()
    start, commands = starting(0, 0)
    assert job.state == "waiting"
    run_job(job, start)
    assert commands == ["train", "evaluate_study"]
    assert job.state == "testing"
    (job.folder / "tests").mkdir()
    (job.folder / "tests" / "as trained.json").write_text(json.dumps({"num_episodes": 3}))
    assert job.state == "finished"
    run_job(job, start)
    assert commands == ["train", "evaluate_study"]


def test_tests_of_fewer_episodes_are_done_again():
    job = toy_job()
    (job.folder / "tests").mkdir(parents=True)
    (job.folder / "tests" / "as trained.json").write_text(json.dumps({"num_episodes": 2}))
    assert not job.tests.is_done()


def test_what_is_not_trained_is_not_tested_and_the_failure_is_marked_with_its_log():
    job = toy_job()
    start, commands = starting(3)
    run_job(job, start)
    assert commands == ["train"]
    assert job.state == "failed"
    assert json.loads(job.failure.read_text()) == {"command": "train", "code": 3, "log": "runs/s/toy/job.log"}
    assert "$ maniskill-grpd train --exp_name s/toy" in job.log.read_text()


@pytest.mark.parametrize("code", [129, 130, 143])
def test_an_interruption_is_no_failure(code):
    job = toy_job()
    start, _ = starting(code)
    run_job(job, start)
    assert not job.failure.exists()


def test_no_end_of_a_command_is_a_failure_while_all_are_asked_to_stop():
    """PyTorch's launcher, which trains with several processes, ends with 1 when it is asked to stop."""
    job = toy_job()
    start, _ = starting(1)
    run_job(job, start, is_stopping=lambda: True)
    assert not job.failure.exists()


def test_the_error_of_a_job_is_the_last_line_that_names_one():
    job = toy_job()
    assert job.first_error() == "no log"
    job.folder.mkdir(parents=True)
    job.log.write_text("begins\nerror: first\nValueError: second\nbye\n")
    assert job.first_error() == "ValueError: second"


def test_two_processes_do_not_work_at_the_same_run():
    started = threading.Event()

    def start(command, **settings):
        started.set()
        return subprocess.Popen([sys.executable, "-c", ""], **settings)

    with hold_lock(toy_job()):
        other = threading.Thread(target=run_job, args=(toy_job(), start))
        other.start()
        assert not started.wait(0.3)
    other.join(timeout=60)
    assert started.is_set()


def test_a_command_that_outlives_its_job_keeps_others_away():
    """The folder of a running training was deleted when the process that had started it was gone."""
    job = toy_job()
    program = (
        "import subprocess, sys\n"
        "from maniskill_grpd.experiments.job import hold_lock\n"
        "from pathlib import Path\n"
        "class Place: folder, name = Path('runs/s/toy'), 'toy'\n"
        "with hold_lock(Place) as lock:\n"
        "    child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'], stdout=-3, pass_fds=(lock,))\n"
        "    print(child.pid, flush=True)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True)
    child = int(done.stdout)
    try:
        with hold_lock(job, is_stopping=lambda: True) as lock:
            assert lock is None
    finally:
        os.kill(child, signal.SIGKILL)
    assert not Path("runs/s/toy").exists()
