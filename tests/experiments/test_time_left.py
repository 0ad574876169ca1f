"""How long jobs will take, as far as it is known."""

import json

import pytest

from maniskill_grpd.experiments.job import Job
from maniskill_grpd.experiments.time_left import STEPS_PER_SECOND, format_seconds, guessed_rate, measured_rate, seconds_left
from maniskill_grpd.experiments.training import Training
from maniskill_grpd.learning import TrainConfig


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def training(name="s/a", **options):
    return Training(TrainConfig(exp_name=name, num_envs=10, num_steps=10, num_minibatches=2, total_timesteps=1000, **options))


def test_a_policy_that_has_not_been_measured_is_guessed_to_be_slow():
    """A policy that is not in the table was a KeyError."""
    assert guessed_rate(training(policy="new")) == guessed_rate(training(policy="empn")) < guessed_rate(training(policy="grpd"))


def test_twice_the_nodes_and_twice_the_epochs_take_four_times_as_long():
    half = training(env_kwargs=("graph_nodes=42",), update_epochs=10)
    assert guessed_rate(half) == pytest.approx(STEPS_PER_SECOND["grpd"] / 4)


def test_a_training_that_runs_tells_the_speed_of_its_kind():
    first, second = training("s/a"), training("s/b")
    guess = seconds_left([Job(run.folder, run) for run in (first, second)], 1)
    first.folder.mkdir(parents=True)
    rows = [
        {"kind": "train", "iteration": 1, "global_step": 100, "time/rollout_time": 60.0, "time/update_time": 30.0},
        {"kind": "eval", "iteration": 1, "global_step": 100, "time/eval_time": 10.0},
    ]
    (first.folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    assert measured_rate(first) == 1.0
    left = seconds_left([Job(run.folder, run) for run in (first, second)], 1)
    assert left > 900 + 1000 > guess
    assert seconds_left([Job(run.folder, run) for run in (first, second)], 2) == left / 2


def test_times_are_read_as_hours_minutes_seconds():
    assert format_seconds(3909.4) == "1:05:09"
