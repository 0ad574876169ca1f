"""Jobs in processes of this machine, and through submitit."""

import os
import signal
import sys
import time

import pytest

from maniskill_grpd.experiments.job import Job, hold_lock
from maniskill_grpd.experiments.launchers import LauncherConfig, LocalLauncher, SlurmLauncher
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.extras import MissingExtraError
from maniskill_grpd.learning import TrainConfig


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def toy_job(name="toy"):
    run = Training(TrainConfig(exp_name=f"s/{name}", num_envs=4, num_steps=5, num_minibatches=2, total_timesteps=40))
    return Job(run.folder, run)


def wait_for(condition, seconds=60.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


def test_stopping_does_not_wait_for_a_run_of_another_study():
    launcher = LocalLauncher(1)
    with hold_lock(toy_job()):
        launcher.launch([toy_job()])
        wait_for(launcher.running)
        launcher.stop()
        assert launcher.is_done()
    assert not launcher._processes


def test_stopping_ends_the_processes_and_is_no_failure():
    launcher = LocalLauncher(1)
    sleeper = [sys.executable, "-c", "import time; time.sleep(600)"]
    start = launcher._start
    launcher._start = lambda command, **settings: start(sleeper, **settings)
    launcher.launch([toy_job(), toy_job("next")])
    wait_for(lambda: launcher._processes)
    launcher.stop()
    assert [process.returncode for process in launcher._processes] == [-signal.SIGTERM]
    assert not toy_job().failure.exists()
    assert toy_job().state == "waiting"


def test_slurm_without_submitit_says_what_to_install(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'maniskill-grpd\[sweep\]'"):
        LauncherConfig(launcher="slurm").make_launcher(folder)


def test_unknown_options_of_slurm_are_refused(folder):
    pytest.importorskip("submitit")
    with pytest.raises(ValueError, match="--slurm: .*colour"):
        SlurmLauncher(folder, parameters={"slurm_colour": "red"}, cluster="local")


def test_what_is_submitted_is_found_in_the_package_without_a_search_path(folder, monkeypatch):
    """Jobs named functions of scripts, for which PYTHONPATH was rewritten in the process of the user."""
    pytest.importorskip("submitit")
    monkeypatch.delenv("PYTHONPATH", raising=False)
    launcher = SlurmLauncher(folder / "submitted", 1, cluster="local")
    launcher.launch([Job(folder / "nothing_to_do")])
    wait_for(launcher.is_done)
    ((_, submitted),) = launcher._submitted
    assert submitted.exception() is None
    assert "PYTHONPATH" not in os.environ


@pytest.mark.parametrize(
    ("options", "message"), [({"jobs": 0}, "jobs must be positive, got 0"), ({"slurm": ("x",)}, "slurm takes")]
)
def test_options_that_mean_nothing_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        LauncherConfig(**options)
