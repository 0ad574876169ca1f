"""Studies from the command line: killed and resumed, failing runs, refusals, tests of checkpoints."""

import csv
import dataclasses
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

import ablate
import evaluate_expert
import evaluate_study
import launchers
import study_jobs
from run_setup import to_arguments
from study_jobs import RUNS, Job

from maniskill_grpd.experiments import STUDIES, Arm, Condition, Run, Study, Task
from maniskill_grpd.experiments.study import to_pairs
from maniskill_grpd.learning import load_checkpoint

SCRIPT = Path(ablate.__file__)
CHECKPOINT = Path(__file__).parents[2] / "checkpoints" / "rope_shaping_w.pt"
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


def toy_job(arm=WHOLE, budget=40):
    return Job(Run(task=TASK, arm=arm, seed=1, budget=budget, train_options=TINY), "toy", (), 1)


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_study_that_is_killed_goes_on_and_tables_and_pictures_come_out(folder, capsys, monkeypatch):
    command = arguments("main", 200, "--tasks", "RopeShaping-v1", "--arms", "grpd", "--seeds", "1")
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    sweep = subprocess.Popen([sys.executable, SCRIPT, *command], start_new_session=True, env=environment)
    wait_for(lambda: any(len(path.read_text().splitlines()) >= 4 for path in RUNS.glob("*/metrics.jsonl")))
    os.killpg(sweep.pid, signal.SIGKILL)
    sweep.wait()
    broken = [path.parent for path in RUNS.glob("*/last.pt")]
    assert len(broken) == 1
    assert not list(RUNS.glob("*/final_ckpt.pt"))
    assert not (RUNS / "results").exists()

    assert ablate.main(command) == 0
    assert f"train.py --resume {broken[0]}" in (broken[0] / "job.log").read_text()
    assert load_checkpoint(broken[0] / "final_ckpt.pt")["global_step"] == 200
    assert (broken[0] / "tests" / "as trained.json").exists()
    page = (RUNS / "results" / "main.md").read_text()
    assert "| RopeShaping-v1 | as trained | 200 | 0 to 1 |" in page
    assert "Runs finished: 1, failed: 0" in page
    assert {"main_bars.png", "main_curves.png"} <= {path.name for path in (RUNS / "results").iterdir()}
    data = RUNS / "results" / "data"
    assert sorted(row["policy"] for row in rows(data / "runs.csv")) == ["", "grpd"]
    assert [row["num_episodes"] for row in rows(data / "tests.csv")] == ["2", "2"]
    assert "| transformer | expert |" in page
    assert len(rows(data / "curves.csv")) == 10

    # What is finished is not run again, neither by this study nor by one that shares its runs.
    monkeypatch.setattr(launchers, "run_job", lambda job, start: pytest.fail(f"{job.run.name} was run again"))
    assert ablate.main(command) == 0
    assert ablate.main([*command[:1], "heterogeneity", *command[2:]]) == 0
    assert "page: runs/ablate/results/heterogeneity.md" in capsys.readouterr().out


def test_a_failed_run_is_marked_with_its_log_and_the_others_go_on(toy, capsys):
    assert ablate.main(arguments("toy", 40, "--seeds", "1", "--jobs", "1")) == 1
    error = capsys.readouterr().err
    assert "failed: " in error
    assert "no_such_option" in error
    assert "job.log" in error
    data = rows(RUNS / "results" / "data" / "runs.csv")
    assert sorted(row["state"] for row in data) == ["failed", "finished"]
    (failed,) = (row["run"] for row in data if row["state"] == "failed")
    assert "no_such_option" in failed
    record = json.loads((RUNS / failed / "failed.json").read_text())
    assert record["script"] == "train.py"
    assert "unknown option 'no_such_option'" in Path(record["log"]).read_text()
    page = (RUNS / "results" / "toy.md").read_text()
    assert "Runs finished: 1, failed: 1" in page
    assert page.count("| failed |") == 1


def test_a_dry_run_lists_runs_and_time_and_does_nothing(folder, capsys):
    assert ablate.main(["--study", "main", "--budget", "20000", "--seeds", "2", "--dry_run"]) == 0
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
    try:
        code = ablate.main(words)
    except SystemExit as exit_info:
        code = exit_info.code
    assert code != 0
    assert message in " ".join(capsys.readouterr().err.split())


def test_missing_checkpoints_are_refused_with_those_there_are(folder, capsys):
    for name in ("some_run", "other_run"):
        (RUNS / name).mkdir(parents=True)
        (RUNS / name / "final_ckpt.pt").touch()
    assert ablate.main(["--study", "noise"]) == 1
    assert "There are: other_run, some_run" in capsys.readouterr().err


def test_a_run_with_other_options_is_not_mixed_in(toy, capsys):
    job = toy_job()
    job.folder.mkdir(parents=True)
    config = {**job.run.train_config().to_dict(), "gamma": 0.5, "num_eval_envs": 1}
    (job.folder / "config.json").write_text(json.dumps({"config": config}))
    with pytest.raises(ValueError, match=r"other options \(gamma was 0.5, is 0.99\); move it away"):
        study_jobs.check_options(job)


def test_the_command_line_of_a_training_gives_its_options():
    config = toy_job().run.train_config()
    words = to_arguments(config)
    assert words[words.index("--env_kwargs") + 1 :][:3] == ["resolution=20", "num_grippers=2", "num_threads=1"]
    assert "--no-capture_video" in words
    import train

    assert train.parse_config(words) == config


def test_two_processes_do_not_work_at_the_same_run(folder):
    started = threading.Event()

    def start(command, **settings):
        started.set()
        return subprocess.Popen([sys.executable, "-c", ""], **settings)

    with study_jobs.hold_lock(toy_job()):
        other = threading.Thread(target=study_jobs.run_job, args=(toy_job(), start))
        other.start()
        assert not started.wait(0.3)
    other.join(timeout=60)
    assert started.is_set()


def test_stopping_does_not_wait_for_a_run_of_another_study(folder):
    launcher = launchers.LocalLauncher(1)
    with study_jobs.hold_lock(toy_job()):
        launcher.launch([toy_job()])
        wait_for(launcher.running)
        launcher.stop()
        assert launcher.is_done()
    assert not launcher._processes


def test_stopping_ends_the_scripts_and_is_no_failure(folder):
    launcher = launchers.LocalLauncher(1)
    sleeper = [sys.executable, "-c", "import time; time.sleep(600)"]
    start = launcher._start
    launcher._start = lambda command, **settings: start(sleeper, **settings)
    launcher.launch([toy_job(), toy_job(budget=60)])
    wait_for(lambda: launcher._processes)
    launcher.stop()
    assert [process.returncode for process in launcher._processes] == [-signal.SIGTERM]
    assert not toy_job().failure.exists()
    assert toy_job().state == "waiting"


def test_slurm_without_submitit_says_what_to_install(toy, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "submitit", None)
    assert ablate.main(arguments("toy", 40, "--launcher", "slurm")) == 1
    assert "pip install submitit" in capsys.readouterr().err


def test_a_checkpoint_is_tested_under_every_condition_once(folder, capsys):
    words = ["--study", "grippers", "--checkpoint", str(CHECKPOINT), "--tests", "tests", "--num_episodes", "2"]
    assert evaluate_study.main(words) == 0
    files = {path.name: path.stat().st_mtime_ns for path in Path("tests").iterdir()}
    assert set(files) == {"as trained.json", "num_grippers=2.json", "num_grippers=3.json"}
    result = json.loads(Path("tests/num_grippers=3.json").read_text())
    assert result["env_kwargs"] == {"num_grippers": 3}
    assert len(result["episodes"]["return"]) == 2
    assert result["mean"]["return"] == pytest.approx(sum(result["episodes"]["return"]) / 2)
    assert evaluate_study.main(words) == 0
    assert {path.name: path.stat().st_mtime_ns for path in Path("tests").iterdir()} == files


def test_noise_changes_what_a_policy_does_and_its_seed_repeats_it(folder):
    import evaluate

    def distances(sigma):
        config = evaluate.EvalConfig(checkpoint=str(CHECKPOINT), num_episodes=2, sigma=sigma)
        return evaluate.evaluate(config)["mean_distance"].tolist()

    assert distances(0.0) != distances(0.05) == distances(0.05)


def test_a_condition_that_the_task_refuses_does_not_stop_the_others(folder, capsys, monkeypatch):
    bad = Condition(env_options={"shapes": "Z"}, factors={"shapes": "Z"})
    good = Condition(env_options={"shapes": "V"}, factors={"shapes": "V"})
    task = dataclasses.replace(TASK, conditions=(bad, good))
    monkeypatch.setitem(STUDIES, "toy", Study(name="toy", title="", question="", tasks=(task,), arms=(WHOLE,)))
    words = ["--study", "toy", "--checkpoint", str(CHECKPOINT), "--tests", "tests", "--num_episodes", "1"]
    assert evaluate_study.main(words) == 1
    assert "error: shapes=Z: goal shapes must be among W, V" in capsys.readouterr().err
    assert "error" in json.loads(Path("tests/shapes=Z.json").read_text())
    assert "mean" in json.loads(Path("tests/shapes=V.json").read_text())


@pytest.mark.parametrize(
    ("study", "message"),
    [
        ("pose_range", "no task like that of the checkpoint, RopeShaping-v1; it has: ClothHanging-v1 "),
        ("cost", "RopeShaping-v1; it has: RopeShaping-v1 resolution=25 graph_nodes=null; RopeShaping-v1 resolution=50 "),
    ],
)
def test_a_checkpoint_of_another_task_is_refused_with_the_tasks_there_are(folder, capsys, study, message):
    assert evaluate_study.main(["--study", study, "--checkpoint", str(CHECKPOINT)]) == 1
    assert message in capsys.readouterr().err


def test_an_expert_is_played_as_policies_are(folder, capsys):
    words = ["--env_id", "RopeShaping-v1", "--env_kwargs", "graph_nodes=21", "--num_episodes", "3", "--json", "expert.json"]
    assert evaluate_expert.main(words) == 0
    result = json.loads(Path("expert.json").read_text())
    assert result["env_kwargs"] == {"graph_nodes": 21}
    assert result["mean"]["success_at_end"] > 0.5
    assert len(result["episodes"]["success_at_end"]) == 3
    with pytest.raises(SystemExit):
        evaluate_expert.main(["--num_episodes", "0"])
    assert "num_episodes must be positive, got 0" in capsys.readouterr().err
    assert evaluate_expert.main(["--env_kwargs", "num_grippers=9"]) == 1
    assert "error: num_grippers must be one of" in capsys.readouterr().err
