"""The record of a run, and names and tasks that are refused in one line."""

import dataclasses
import json
from pathlib import Path

import pytest
import torch

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.environments import check_task
from maniskill_grpd.runs.record import make_run_name, read_progress, read_run_config, write_run_record
from maniskill_grpd.tasks import RopeShapingEnv

TASK = {"progress": {"name": "mean_distance", "unit": "m"}, "fingerprint": "0" * 16}


def write(folder, **options):
    write_run_record(folder, TrainConfig(**options), torch.device("cpu"), TASK)


def test_a_record_that_cannot_be_written_leaves_the_one_before(tmp_path, monkeypatch):
    """It was rewritten in place at every resume, so that a full disk cost the run."""
    write(tmp_path, seed=1)

    def full(self, text, **_):
        with self.open("w") as file:
            file.write(text[:100])
        raise OSError("no space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(OSError, match="no space left"):
        write(tmp_path, seed=2)
    assert read_run_config(tmp_path).seed == 1
    assert [path.name for path in tmp_path.iterdir()] == ["config.json"]


def test_a_record_holds_progress_and_fingerprint(tmp_path):
    write(tmp_path)
    assert read_progress(tmp_path) == RopeShapingEnv.PROGRESS
    assert json.loads((tmp_path / "config.json").read_text())["fingerprint"] == "0" * 16


def test_a_damaged_record_is_named_with_its_line(tmp_path):
    write(tmp_path)
    lines = (tmp_path / "config.json").read_text().splitlines()
    (tmp_path / "config.json").write_text("\n".join(lines[:5]))
    with pytest.raises(ValueError, match=r"config.json, line 5: damaged"):
        read_run_config(tmp_path)


@pytest.mark.parametrize("name", ["../x", "/x", "a/../../x", "", "."])
def test_names_that_lead_out_of_the_folder_of_runs_are_refused(name):
    with pytest.raises(ValueError, match="below runs/"):
        make_run_name(dataclasses.replace(TrainConfig(), exp_name=name))
    assert make_run_name(TrainConfig(exp_name="study/run")) == "study/run"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--env_id", "RopeShapng-v1"], "there is no task 'RopeShapng-v1'"),
        (["--env_id", "no_such_module:Task-v1"], "there is no module 'no_such_module' with tasks; install it, or run"),
        (["--env_id", "json:Task-v1"], "there is no task 'Task-v1'"),
        (["--env_id", "PickCube-v1"], "there are ClothFolding-v1"),
        (["--env_kwargs", "colour=red"], "RopeShaping-v1 does not take the option(s) colour; it takes "),
        (["--env_kwargs", "obs_mode=state"], "obs_mode must be graph"),
    ],
)
def test_tasks_that_cannot_be_made_are_refused_in_one_line(words, message, tmp_path, monkeypatch, capsys):
    """They ended in a traceback."""
    monkeypatch.chdir(tmp_path)
    assert main(["train", *words]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("options", [{"obs_mode": "graph+rgb"}, {"obs_mode": "graph", "resolution": 20, "reward_mode": "sparse"}])
def test_options_of_the_task_and_of_maniskill_are_taken(options):
    check_task("RopeShaping-v1", options)
