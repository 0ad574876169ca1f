"""The command that plans: results, cost, recordings that can be learned from, and what it refuses."""

import json

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import plan, train
from maniskill_grpd.commands.dispatch import COMMANDS
from maniskill_grpd.imitation.demonstrations import load_demonstrations
from maniskill_grpd.runs.checkpoints import load_policy

ROPE = ["--env_kwargs", "resolution=20", "graph_nodes=6", "max_episode_steps=6"]
TASK = ["--env_id", "RopeShaping-v1", *ROPE]
SMALL = [
    *(
        "--horizon",
        "4",
        "--replan",
        "3",
        "--samples",
        "8",
        "--elite_share",
        "0.25",
        "--iterations",
        "2",
        "--first_iterations",
        "3",
    ),
    *("--num_envs", "2", "--num_episodes", "3", "--sim_backend", "cpu"),
]
SIZES = "--num_envs 4 --num_steps 5 --num_minibatches 2 --update_epochs 1 --eval_freq 0 --total_timesteps 20 --no-capture_video"


def test_episodes_are_planned_and_reported_alike_each_time(tmp_path, monkeypatch, capsys):
    """A search of three iterations and one of two, of eight samples of four steps; the last batch is filled up and cut."""
    monkeypatch.chdir(tmp_path)
    assert "plan" in COMMANDS
    for name in ("one.json", "two.json"):
        assert plan.main([*TASK, *SMALL, "--json", name]) == 0
    assert "3 episodes, seeds 1000000 to 1000002" in capsys.readouterr().out
    one, two = (json.loads((tmp_path / name).read_text()) for name in ("one.json", "two.json"))
    assert one["episodes"]["plan_steps"] == [(3 + 2) * 8 * 4] * 3
    assert one["planner"]["horizon"] == 4
    assert min(one["episodes"]["plan_seconds"]) > 0.0
    for result in (one, two):
        del result["episodes"]["plan_seconds"]
    assert one["episodes"] == two["episodes"]


def test_what_is_recorded_can_be_learned_from_and_what_was_learned_is_refined(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = [*TASK, *SMALL, "--record", "demos", "--keep_failures", "--video", "planned.gif"]
    assert plan.main(words) == 0
    told = capsys.readouterr().out
    assert "trajectory.h5: 3 of 3 episodes" in told
    assert "video: planned." in told
    assert plan.main(words) == 1
    assert "choose another folder" in capsys.readouterr().err
    learned = [*TASK, *SIZES.split(), "--demonstrations", "demos/trajectory.h5", "--exp_name", "warm", "--sim_backend", "cpu"]
    assert train.main(learned) == 0
    policy, _ = load_policy("runs/warm/final_ckpt.pt")
    assert load_demonstrations(tmp_path / "demos/trajectory.h5", policy.schema).num_episodes == 3
    assert plan.main(["--checkpoint", "runs/warm/final_ckpt.pt", "--use_value", *SMALL, "--json", "prior.json"]) == 0
    found = json.loads((tmp_path / "prior.json").read_text())
    assert found["env_id"] == "RopeShaping-v1"
    assert found["episodes"]["plan_steps"] == [(2 + 3 + 2) * 8 * 4] * 3  # the policy is played once for each search
    assert plan.main(["--checkpoint", "runs/warm/final_ckpt.pt", "--env_id", "RopeWrapping-v1", *SMALL]) == 1
    assert "trained on other observations" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (SMALL, "give the task as --env_id"),
        ([*TASK, "--use_value"], "--use_value needs the value function"),
        ([*TASK, "--keep_failures"], "--keep_failures needs --record"),
        ([*TASK, "--replan", "50"], "replan must not exceed horizon = 20, got 50"),
        ([*TASK, "--num_envs", "17", "--video", "x.mp4"], "a video shows at most 16 episodes"),
        (["--env_id", "Nothing-v1", *SMALL], "there is no task"),
        (["--checkpoint", "none.pt", *SMALL], "none.pt"),
    ],
)
def test_what_cannot_be_planned_is_refused(words, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert plan.main(words) != 0
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
