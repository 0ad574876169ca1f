"""ManiSkill's replay tool knows our tasks, and replays them exactly."""

import json

import gymnasium as gym
import h5py
import numpy as np
import pytest
import torch
from mani_skill.utils.wrappers import RecordEpisode

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.trajectory.replay import replay


@pytest.fixture
def recorded(tmp_path):
    """Return the path of three recorded episodes of 5 steps."""
    env = gym.make("RopeShaping-v1", num_envs=3, obs_mode="graph", sim_backend="cpu", max_episode_steps=5)
    env = RecordEpisode(env, tmp_path, trajectory_name="trajectory", save_video=False)
    env.reset(seed=[4, 5, 6])
    for step in range(5):
        env.step(torch.randn(3, 12, generator=torch.Generator().manual_seed(step)))
    env.reset()
    env.close()
    return tmp_path / "trajectory.h5"


@pytest.mark.parametrize("flags", [[], ["--use-env-states"], ["--use-first-env-state"]])
def test_episodes_are_replayed_side_by_side_in_another_mode(recorded, flags):
    replay(["--traj-path", str(recorded), "--save-traj", "--allow-failure", "--record-rewards", "-o", "state", "-n", "2", *flags])
    path = recorded.with_name("trajectory.state.pd_ee_delta_pos.warp_cpu.h5")
    episodes = json.loads(path.with_suffix(".json").read_text())["episodes"]
    assert sorted(episode["episode_seed"] for episode in episodes) == [4, 5, 6]
    with h5py.File(recorded) as original, h5py.File(path) as replayed:
        seeds = {e["episode_seed"]: e["episode_id"] for e in json.loads(recorded.with_suffix(".json").read_text())["episodes"]}
        for episode in episodes:
            new = replayed[f"traj_{episode['episode_id']}"]
            old = original[f"traj_{seeds[episode['episode_seed']]}"]
            assert new["obs"].shape[0] == 6
            np.testing.assert_array_equal(new["actions"], old["actions"])
            if not flags:
                np.testing.assert_array_equal(new["rewards"], old["rewards"])
                np.testing.assert_array_equal(new["env_states/solver/positions"], old["env_states/solver/positions"])


def test_missing_files_are_named(tmp_path, recorded):
    with pytest.raises(FileNotFoundError, match=r"nothing\.h5 is missing"):
        replay(["--traj-path", str(tmp_path / "nothing.h5")])
    recorded.with_suffix(".json").unlink()
    with pytest.raises(FileNotFoundError, match=r"trajectory\.json is missing"):
        replay(["--traj-path", str(recorded)])


def test_unknown_backends_are_refused(recorded):
    with pytest.raises(ValueError, match="unknown sim_backend 'tpu'"):
        replay(["--traj-path", str(recorded), "-b", "tpu"])
