"""Tests of checkpoints under the conditions of a study, and of the expert beside them."""

import dataclasses
import json
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.experiments import STUDIES, Arm, Condition, Study, Task
from maniskill_grpd.runs.evaluation import EvaluationConfig, evaluate

CHECKPOINT = Path(__file__).parents[2] / "checkpoints" / "rope_shaping_w.pt"
TASK = Task(env_id="RopeShaping-v1", options={"resolution": 20, "num_grippers": 2}, conditions=())


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_a_checkpoint_is_tested_under_every_condition_once(capsys):
    words = ["--study", "grippers", "--checkpoint", str(CHECKPOINT), "--output", "tests", "--num_episodes", "2"]
    assert main(["evaluate_study", *words]) == 0
    files = {path.name: path.stat().st_mtime_ns for path in Path("tests").iterdir()}
    assert set(files) == {"as trained.json", "num_grippers=2.json", "num_grippers=3.json"}
    result = json.loads(Path("tests/num_grippers=3.json").read_text())
    assert result["env_kwargs"] == {"graph_features": "rich", "num_grippers": 3}
    assert len(result["episodes"]["return"]) == 2
    assert result["mean"]["return"] == pytest.approx(sum(result["episodes"]["return"]) / 2)
    assert main(["evaluate_study", *words]) == 0
    assert {path.name: path.stat().st_mtime_ns for path in Path("tests").iterdir()} == files


def test_noise_changes_what_a_policy_does_and_its_seed_repeats_it():
    def distances(sigma):
        config = EvaluationConfig(checkpoint=CHECKPOINT, num_episodes=2, sigma=sigma)
        return evaluate(config).episodes["mean_distance"].tolist()

    assert distances(0.0) != distances(0.05) == distances(0.05)


def test_a_condition_that_the_task_refuses_does_not_stop_the_others(capsys, monkeypatch):
    bad = Condition(env_options={"shapes": "Z"}, factors={"shapes": "Z"})
    good = Condition(env_options={"shapes": "V"}, factors={"shapes": "V"})
    task = dataclasses.replace(TASK, conditions=(bad, good))
    monkeypatch.setitem(STUDIES, "toy", Study(name="toy", title="", question="", tasks=(task,), arms=(Arm(name="whole"),)))
    words = ["--study", "toy", "--checkpoint", str(CHECKPOINT), "--output", "tests", "--num_episodes", "1"]
    assert main(["evaluate_study", *words]) == 1
    assert "error: shapes=Z: goal shapes must be among W, V" in capsys.readouterr().err
    assert "error" in json.loads(Path("tests/shapes=Z.json").read_text())
    assert "mean" in json.loads(Path("tests/shapes=V.json").read_text())


@pytest.mark.parametrize(
    ("study", "message"),
    [
        ("pose_range", 'no task like that of the checkpoint, RopeShaping-v1 graph_features="rich"; it has: ClothHanging-v1 '),
        ("cost", "it has: RopeShaping-v1 resolution=25 graph_nodes=null; RopeShaping-v1 resolution=50 "),
    ],
)
def test_a_checkpoint_of_another_task_is_refused_with_the_tasks_there_are(capsys, study, message):
    assert main(["evaluate_study", "--study", study, "--checkpoint", str(CHECKPOINT)]) == 1
    assert message in capsys.readouterr().err


def test_an_expert_is_played_as_policies_are(capsys):
    words = ["--env_id", "RopeShaping-v1", "--env_kwargs", "graph_nodes=21", "--num_episodes", "3", "--json", "expert.json"]
    assert main(["evaluate_expert", *words]) == 0
    result = json.loads(Path("expert.json").read_text())
    assert result["env_kwargs"] == {"graph_nodes": 21}
    assert result["mean"]["success_at_end"] > 0.5
    assert len(result["episodes"]["success_at_end"]) == 3
    assert main(["evaluate_expert", "--num_episodes", "0"]) == 2
    assert "num_episodes must be positive, got 0" in capsys.readouterr().err
    assert main(["evaluate_expert", "--env_kwargs", "num_grippers=9"]) == 1
    assert "error: num_grippers must be one of" in capsys.readouterr().err
