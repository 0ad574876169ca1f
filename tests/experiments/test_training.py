"""What a job does to the folder of a run: it begins, resumes and refuses, and deletes nothing but the record of a run."""

import json

import pytest

from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.folder import RUNS

SIZES = {"num_envs": 4, "num_steps": 5, "num_minibatches": 2, "total_timesteps": 40}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def training(name="s/seed=1", **options):
    return Training(TrainConfig(exp_name=name, **SIZES, **options))


def write_run(run, steps=20, **changes):
    """Leave what a training leaves that was interrupted before its first checkpoint."""
    run.folder.mkdir(parents=True)
    (run.folder / "config.json").write_text(json.dumps({"config": {**run.config.to_dict(), **changes}}))
    (run.folder / "metrics.jsonl").write_text(json.dumps({"kind": "train", "iteration": 1, "global_step": steps}) + "\n")
    (run.folder / "events.out.tfevents.1").touch()


@pytest.mark.parametrize("name", ["../precious", "s/../../precious", "/precious", "", "."])
def test_no_run_lies_outside_the_folder_of_runs(name):
    with pytest.raises(ValueError, match=r"runs go to folders below runs/, got the name"):
        training(name)


def test_a_folder_of_other_files_is_refused_and_kept():
    """A sweep deleted it, for want of a checkpoint."""
    run = training()
    run.folder.mkdir(parents=True)
    (run.folder / "thesis.tex").write_text("years of work")
    with pytest.raises(ValueError, match=r"runs/s/seed=1 is not the folder of a run but holds thesis\.tex; move it away"):
        Job(run.folder, run).check()
    run.prepare()
    assert (run.folder / "thesis.tex").read_text() == "years of work"


def test_a_run_without_a_checkpoint_begins_anew_and_loses_its_record_only():
    run = training()
    write_run(run)
    (run.folder / "notes.md").write_text("mine")
    run.prepare()
    assert [path.name for path in run.folder.iterdir()] == ["notes.md"]
    assert run.words[:3] == ["train", "--exp_name", "s/seed=1"]


def test_a_run_with_a_checkpoint_is_resumed_and_loses_nothing():
    run = training()
    write_run(run)
    (run.folder / "last.pt").touch()
    before = sorted(run.folder.iterdir())
    run.prepare()
    assert sorted(run.folder.iterdir()) == before
    assert run.words == ["train", "--resume", "runs/s/seed=1"]


def test_a_run_of_ones_own_task_is_resumed_with_leave_to_import_its_module():
    run = training(env_id="own_task:RopeClosing-v1")
    write_run(run)
    (run.folder / "last.pt").touch()
    assert run.words == ["train", "--resume", "runs/s/seed=1", "--allow_import"]


def test_a_finished_run_without_checkpoints_is_not_trained_again():
    """It left no final_ckpt.pt, and so was deleted and trained anew by the same sweep."""
    finished, interrupted = training("s/a", save_model=False), training("s/b", save_model=False)
    write_run(finished, steps=40)
    write_run(interrupted, steps=20)
    assert Job(finished.folder, finished).state == "finished"
    assert Job(interrupted.folder, interrupted).state == "training"


def test_a_training_is_done_when_its_last_checkpoint_is_there():
    run = training()
    write_run(run, steps=40)
    assert not run.is_done()
    (run.folder / "final_ckpt.pt").touch()
    assert run.is_done()
    assert run.steps == 40


@pytest.mark.parametrize("change", [{"gamma": 0.5}, {"total_timesteps": 80}])
def test_a_run_with_other_options_is_not_mixed_in(change):
    run = training()
    write_run(run, num_eval_envs=1, **change)
    ((name, value),) = change.items()
    with pytest.raises(ValueError, match=rf"other options \({name} was {value}, is .*\); move it away"):
        run.check()


def test_options_that_do_not_change_a_training_may_differ():
    run = training()
    write_run(run, num_eval_envs=1, sim_backend="cuda", capture_video=False)
    run.check()


def test_a_damaged_record_is_named():
    run = training()
    write_run(run)
    (run.folder / "config.json").write_text('{\n"config": {')
    with pytest.raises(ValueError, match=r"runs/s/seed=1/config\.json, line 2"):
        run.check()
    (run.folder / "config.json").write_text("{}")
    with pytest.raises(ValueError, match=r"config\.json names no options of a training"):
        run.check()


def test_runs_lie_below_the_present_folder(folder):
    assert training().folder.resolve() == folder / RUNS / "s" / "seed=1"
