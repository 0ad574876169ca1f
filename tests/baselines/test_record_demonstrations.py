"""Demonstrations of every expert are recorded in ManiSkill's format and replay from their states."""

import json

import h5py
import numpy as np
import pytest

pytest.importorskip("mani_skill")

import record_demonstrations

from maniskill_grpd.experts import EXPERTS
from maniskill_grpd.trajectory.replay import replay


@pytest.mark.parametrize("env_id", sorted(EXPERTS))
def test_experts_record_successes_that_replay_from_state_and_from_actions(env_id, tmp_path):
    arguments = ["--env_id", env_id, "--num_episodes", "3", "--num_envs", "2", "--seed", "40", "--output", str(tmp_path)]
    assert record_demonstrations.main([*arguments, "--sim_backend", "cpu"]) == 0
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
                ends = [f[name]["env_states/solver/positions"][-1 - bool(flags)] for f in (original, file)]
                np.testing.assert_allclose(*ends, atol=0.0 if not flags else 1e-2)


def test_recordings_are_not_overwritten(tmp_path, capsys):
    (tmp_path / "trajectory.h5").touch()
    assert record_demonstrations.main(["--output", str(tmp_path)]) == 1
    assert "exists; choose another --output" in capsys.readouterr().err
