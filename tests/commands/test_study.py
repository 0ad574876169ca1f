"""Studies from the command line: killed and resumed, failing runs, refusals."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import pytest

pytest.importorskip("mani_skill")

from mani_skill.utils.registration import REGISTERED_ENVS

from maniskill_grpd.commands import main
from maniskill_grpd.experiments import STUDIES, Arm, Study, Task, launchers
from maniskill_grpd.experiments.study import to_pairs
from maniskill_grpd.experiments.study_jobs import STUDY_RUNS
from maniskill_grpd.learning import load_checkpoint
from maniskill_grpd.runs.environments import registered_tasks
from maniskill_grpd.tasks import DeformableEnv

TINY = {"num_envs": 4, "num_steps": 5, "num_minibatches": 2, "update_epochs": 1, "num_eval_envs": 2}
TASK = Task(env_id="RopeShaping-v1", options={"resolution": 20, "num_grippers": 2}, conditions=())
WHOLE, BROKEN = Arm(name="whole"), Arm(name="broken", policy_options={"no_such_option": 1})


def arguments(study, budget, *more):
    return ["--study", study, "--budget", str(budget), "--num_episodes", "2", *more, "--train_options", *to_pairs(TINY)]


def wait_for(condition, seconds=300.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def toy(folder, monkeypatch):
    """A study without tests, whose second arm cannot be trained."""
    study = Study(
        name="toy",
        title="Toy",
        question="?",
        tasks=(TASK,),
        arms=(WHOLE, BROKEN),
        metrics=("training_return",),
        plots=("curves",),
    )
    monkeypatch.setitem(STUDIES, "toy", study)
    return study


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_study_that_is_killed_goes_on_and_tables_and_pictures_come_out(folder, capsys, monkeypatch):
    command = arguments("main", 200, "--tasks", "RopeShaping-v1", "--arms", "grpd", "--seeds", "1")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    sweep = subprocess.Popen([sys.executable, "-m", "maniskill_grpd", "study", *command], start_new_session=True, env=environment)
    wait_for(lambda: any(len(path.read_text().splitlines()) >= 4 for path in STUDY_RUNS.glob("*/metrics.jsonl")))
    os.killpg(sweep.pid, signal.SIGKILL)
    sweep.wait()
    broken = [path.parent for path in STUDY_RUNS.glob("*/last.pt")]
    assert len(broken) == 1
    assert not list(STUDY_RUNS.glob("*/final_ckpt.pt"))
    assert not (STUDY_RUNS / "results").exists()

    assert main(["study", *command]) == 0
    assert f"maniskill-grpd train --resume {broken[0]}" in (broken[0] / "job.log").read_text()
    assert load_checkpoint(broken[0] / "final_ckpt.pt")["global_step"] == 200
    assert (broken[0] / "tests" / "as trained.json").exists()
    page = (STUDY_RUNS / "results" / "main.md").read_text()
    assert "| RopeShaping-v1 | as trained | 200 | 0 to 1 |" in page
    assert "Runs finished: 1, failed: 0" in page
    assert {"main_bars.png", "main_curves.png"} <= {path.name for path in (STUDY_RUNS / "results").iterdir()}
    data = STUDY_RUNS / "results" / "data"
    assert sorted(row["policy"] for row in rows(data / "runs.csv")) == ["", "grpd"]
    assert [row["num_episodes"] for row in rows(data / "tests.csv")] == ["2", "2"]
    assert "| transformer | expert |" in page
    assert len(rows(data / "curves.csv")) == 10

    # What is finished is not run again, neither by this study nor by one that shares its runs.
    monkeypatch.setattr(launchers, "run_job", lambda job, *_: pytest.fail(f"{job.name} was run again"))
    assert main(["study", *command]) == 0
    assert main(["study", *command[:1], "decoder", *command[2:]]) == 0
    assert "page: runs/ablate/results/decoder.md" in capsys.readouterr().out


def test_a_failed_run_is_marked_with_its_log_and_the_others_go_on(toy, capsys):
    assert main(["study", *arguments("toy", 40, "--seeds", "1", "--jobs", "1")]) == 1
    error = capsys.readouterr().err
    assert "failed: " in error
    assert "no_such_option" in error
    assert "job.log" in error
    data = rows(STUDY_RUNS / "results" / "data" / "runs.csv")
    assert sorted(row["state"] for row in data) == ["failed", "finished"]
    (failed,) = (row["run"] for row in data if row["state"] == "failed")
    assert "no_such_option" in failed
    record = json.loads((STUDY_RUNS / failed / "failed.json").read_text())
    assert record["command"] == "train"
    assert "unknown option 'no_such_option'" in Path(record["log"]).read_text()
    page = (STUDY_RUNS / "results" / "toy.md").read_text()
    assert "Runs finished: 1, failed: 1" in page
    assert page.count("| failed |") == 1


def test_a_smoke_test_plans_every_arm_once_and_takes_no_budget_of_ones_own(folder, capsys):
    assert main(["study", "--study", "main", "--quick", "--dry_run"]) == 0
    assert capsys.readouterr().out.splitlines()[-1].startswith("16 runs and 4 experts with 20 tests")
    assert main(["study", "--study", "main", "--quick", "--budget", "1000"]) == 2
    assert "--quick has a budget of its own" in capsys.readouterr().err


def test_a_dry_run_lists_runs_and_time_and_does_nothing(folder, capsys):
    assert main(["study", "--study", "main", "--budget", "20000", "--seeds", "2", "--dry_run"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4 * 4 * 2 + 4 + 1
    assert lines[-1].startswith("32 runs and 4 experts with 36 tests")
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--study", "nose"], "unknown study 'nose'; there are main, "),
        (["--study", "all"], "unknown study 'all'"),
        (["--study", "main", "--tasks", "Foo-v1"], "no task Foo-v1; it has ClothFolding-v1"),
        (["--study", "main", "--arms", "mlp"], "no arm mlp; it has empn"),
        (["--study", "noise"], "run --study main first, or give its --budget. There are: none"),
        (["--study", "main", "--train_options", "no_such=1"], "unknown option(s) no_such"),
        (["--study", "main", "--seeds", "0"], "seeds must be positive, got 0"),
    ],
)
def test_what_cannot_be_run_is_refused_in_one_line(folder, capsys, words, message):
    assert main(["study", *words]) != 0
    assert message in " ".join(capsys.readouterr().err.split())


def test_missing_checkpoints_are_refused_with_those_there_are(folder, capsys):
    for name in ("some_run", "other_run"):
        (STUDY_RUNS / name).mkdir(parents=True)
        (STUDY_RUNS / name / "final_ckpt.pt").touch()
    assert main(["study", "--study", "noise"]) == 1
    assert "There are: other_run, some_run" in capsys.readouterr().err


def test_a_damaged_table_stops_a_study_before_it_begins(toy, capsys):
    """It stopped it at its end, after the trainings, and with a bare KeyError."""
    data = STUDY_RUNS / "results" / "data"
    data.mkdir(parents=True)
    (data / "tests.csv").write_text("run,condition,return\na,as trained\n")
    assert main(["study", *arguments("toy", 40, "--seeds", "1")]) == 1
    assert f"{data}/tests.csv, line 2: 2 fields, where the head has 3" in capsys.readouterr().err
    assert not list(STUDY_RUNS.glob("*/config.json"))


OWN_TASK = """
from mani_skill.utils.registration import register_env
from maniskill_grpd.tasks import RopeShapingEnv

@register_env("OwnShaping-v1", max_episode_steps=100)
class OwnShapingEnv(RopeShapingEnv):
    STUDY_OPTIONS = {"resolution": 20}
"""


@pytest.fixture
def own_task(folder, monkeypatch):
    """Name a task in a module of its own, which is forgotten again."""
    (folder / "own_shaping.py").write_text(OWN_TASK)
    monkeypatch.syspath_prepend(str(folder))
    for name, study in STUDIES.items():
        monkeypatch.setitem(STUDIES, name, study)
    yield "own_shaping:OwnShaping-v1"
    for registry in (REGISTERED_ENVS, gym.registry):
        registry.pop("OwnShaping-v1", None)
    sys.modules.pop("own_shaping", None)


def test_a_task_of_ones_own_reaches_the_studies_with_its_options(own_task, capsys):
    words = arguments("main", 40, "--own_tasks", own_task, "--tasks", own_task, "--arms", "grpd", "--dry_run")
    assert main(["study", *words]) == 0
    assert f"{own_task},resolution=20__grpd" in capsys.readouterr().out


def test_every_task_of_the_package_is_in_the_studies_of_all_tasks(folder, monkeypatch):
    for name, study in STUDIES.items():
        monkeypatch.setitem(STUDIES, name, study)
    added = type("AddedEnv", (DeformableEnv,), {"__module__": "maniskill_grpd.tasks.added", "STUDY_OPTIONS": {"resolution": 20}})
    monkeypatch.setitem(REGISTERED_ENVS, "Added-v1", SimpleNamespace(cls=added))
    assert main(["study", *arguments("main", 40, "--dry_run")]) == 0
    tasks = {task.env_id: task.options for task in STUDIES["main"].tasks}
    assert {name for name, task in registered_tasks().items() if task.__module__.startswith("maniskill_grpd.")} <= set(tasks)
    assert tasks["Added-v1"] == {"resolution": 20}
