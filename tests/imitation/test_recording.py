"""Demonstrations of every expert are recorded in ManiSkill's format and replay from their states."""

import json

import h5py
import numpy as np
import pytest
import torch

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import record
from maniskill_grpd.experts import EXPERTS
from maniskill_grpd.tasks import RopeShapingEnv
from maniskill_grpd.trajectory.replay import replay


@pytest.mark.parametrize("env_id", sorted(EXPERTS))
def test_experts_record_successes_that_replay_from_state_and_from_actions(env_id, tmp_path):
    arguments = ["--env_id", env_id, "--num_episodes", "3", "--num_envs", "2", "--seed", "40", "--output", str(tmp_path)]
    assert record.main([*arguments, "--sim_backend", "cpu"]) == 0
    path = tmp_path / "trajectory.h5"
    episodes = json.loads(path.with_suffix(".json").read_text())["episodes"]
    assert [episode["episode_seed"] for episode in episodes] == [40, 41, 42]
    assert all(episode["success"] for episode in episodes)
    for flags in ([], ["--use-env-states"]):
        replay(["--traj-path", str(path), "--save-traj", "-o", "state", "-n", "3", *flags])
        replayed = path.with_name("trajectory.state.pd_ee_delta_pos.warp_cpu.h5")
        with h5py.File(path) as original, h5py.File(replayed) as file:
            assert len(file) == 3  # only successes are saved
            for name in file:
                np.testing.assert_array_equal(*(f[name]["env_states/solver/positions"] for f in (original, file)))
        replayed.unlink()


def test_teams_of_arms_record_and_replay_too(tmp_path):
    task = ["--env_id", "RopeWrapping-v1", "--env_kwargs", 'robot_uids=["panda", "panda"]', "pose_range=quarter"]
    assert record.main([*task, "--num_episodes", "2", "--output", str(tmp_path), "--sim_backend", "cpu"]) == 0
    path = tmp_path / "trajectory.h5"
    replay(["--traj-path", str(path), "--save-traj", "-o", "state"])
    with h5py.File(path) as original, h5py.File(path.with_name("trajectory.state.pd_ee_delta_pos.warp_cpu.h5")) as file:
        assert len(file) == 2
        for name in file:
            for agent in ("panda-agent-0", "panda-agent-1"):
                states = [f[name][f"env_states/articulations/{agent}"] for f in (original, file)]
                np.testing.assert_array_equal(*states)


def test_episodes_that_fail_are_not_glued_to_the_next_ones_that_succeed(tmp_path, monkeypatch):
    """They once stayed in the recorder, and the next episode of their world was written behind them."""
    evaluate = RopeShapingEnv.evaluate
    is_good = lambda env: torch.as_tensor(np.asarray(env._episode_seed) >= 2)  # noqa: E731
    monkeypatch.setattr(RopeShapingEnv, "evaluate", lambda self: evaluate(self) | {"success": is_good(self)})
    arguments = ["--num_episodes", "4", "--num_envs", "2", "--output", str(tmp_path), "--env_kwargs", "max_episode_steps=3"]
    assert record.main([*arguments, "--sim_backend", "cpu"]) == 0
    with h5py.File(tmp_path / "trajectory.h5") as file:
        assert [len(file[name]["actions"]) for name in file] == [3, 3]


def test_recordings_are_not_overwritten(tmp_path, capsys):
    (tmp_path / "trajectory.h5").touch()
    assert record.main(["--output", str(tmp_path)]) == 1
    assert "exists; choose another --output" in capsys.readouterr().err
