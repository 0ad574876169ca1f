"""ManiSkill's wrappers work on a batch of worlds without changes."""

import json

import gymnasium as gym
import h5py
import imageio.v3 as imageio
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from mani_skill.trajectory import utils as trajectory_utils
from mani_skill.utils import common
from mani_skill.utils.wrappers.gymnasium import CPUGymWrapper
from mani_skill.utils.wrappers.record import RecordEpisode
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv


def put_at_goal(base, worlds):
    """Lay the ropes of some worlds onto their goals."""
    base.solver.positions[worlds] = base.goal_positions[worlds]
    base.solver.velocities[worlds] = 0.0
    at_nodes = base.solver.positions[worlds][:, base.start_nodes[0]]
    base.solver.gripper_positions[worlds] = at_nodes
    base.solver.gripper_targets[worlds] = at_nodes


# ---------------------------------------------------------------- vector environments


def test_vector_env_resets_at_the_time_limit_and_reports_metrics(make_env, draw_actions):
    env = ManiSkillVectorEnv(make_env(max_episode_steps=5, graph_nodes=None), record_metrics=True)
    env.reset(seed=0)
    rewards = []
    for action in draw_actions(5, 3):
        obs, reward, terminated, truncated, info = env.step(action)
        rewards.append(reward)
    assert truncated.all()
    assert not terminated.any()
    assert info["_final_info"].all()
    episode = info["final_info"]["episode"]
    assert episode["episode_len"].tolist() == [5, 5, 5]
    torch.testing.assert_close(episode["return"], torch.stack(rewards).sum(dim=0))
    assert not episode["success_once"].any()
    assert not episode["fail_once"].any()
    last = info["final_observation"]["graph"]["object"]["position"]
    new = obs["graph"]["object"]["position"]
    assert (last - new).norm(dim=-1).amax() > 0.05
    assert torch.equal(new, env.unwrapped.solver.positions)
    assert (new[..., 2] - env.unwrapped.solver.model.radius).abs().max() < 1e-6
    assert env.unwrapped.elapsed_steps.tolist() == [0, 0, 0]


def test_vector_env_resets_worlds_that_succeed_and_lets_the_others_go_on(make_env):
    env = ManiSkillVectorEnv(make_env(), record_metrics=True)
    env.reset(seed=0)
    put_at_goal(env.unwrapped, [1])
    _, _, terminated, truncated, info = env.step(torch.zeros(3, 12))
    assert terminated.tolist() == [False, True, False]
    assert not truncated.any()
    assert info["final_info"]["episode"]["success_once"].tolist() == [False, True, False]
    assert env.unwrapped.elapsed_steps.tolist() == [1, 0, 1]


def test_vector_env_can_ignore_success(make_env):
    env = ManiSkillVectorEnv(make_env(max_episode_steps=2), ignore_terminations=True, record_metrics=True)
    env.reset(seed=0)
    put_at_goal(env.unwrapped, [1])
    env.step(torch.zeros(3, 12))
    info = env.step(torch.zeros(3, 12))[4]
    episode = info["final_info"]["episode"]
    assert episode["episode_len"].tolist() == [2, 2, 2]
    assert episode["success_at_end"].tolist() == [False, True, False]


def test_vector_env_can_be_made_by_name():
    env = ManiSkillVectorEnv("RopeShaping-v1", num_envs=2, sim_backend="cpu", obs_mode="state")
    obs, _ = env.reset(seed=1)
    assert obs.shape == (2, *env.single_observation_space.shape)
    env.close()


def test_max_episode_steps_defaults_to_100_and_can_be_overridden(make_env):
    for options, limit in (({}, 100), ({"max_episode_steps": 3}, 3)):
        env = make_env(1, **options)
        truncated = [bool(env.step(None)[3]) for _ in range(limit)]
        assert truncated == [False] * (limit - 1) + [True]


# ---------------------------------------------------------------- a single world in plain gymnasium


@pytest.mark.parametrize("obs_mode", ["graph", "state"])
def test_cpu_gym_wrapper_speaks_plain_gymnasium(make_env, obs_mode):
    env = CPUGymWrapper(make_env(1, obs_mode=obs_mode), record_metrics=True)
    obs, info = env.reset(seed=3)
    assert env.observation_space.contains(obs)
    assert env.action_space.shape == (12,)
    obs, reward, terminated, truncated, info = env.step(env.action_space.sample())
    assert env.observation_space.contains(obs)
    assert isinstance(reward, float)
    assert isinstance(terminated, bool)
    assert isinstance(truncated, bool)
    assert isinstance(info["success"], bool)
    assert isinstance(info["mean_distance"], float)
    assert info["episode"]["episode_len"] == 1
    with pytest.raises(ValueError, match="must be finite"):
        env.step(np.full(12, np.nan, dtype=np.float32))


@pytest.mark.parametrize("obs_mode", ["graph", "state"])
def test_a_plain_environment_passes_the_checks_of_gymnasium(make_env, obs_mode):
    # The checks of rendering and closing make the environment anew, which the time limit of ManiSkill does not allow.
    check_env(CPUGymWrapper(make_env(1, obs_mode=obs_mode)), skip_render_check=True, skip_close_check=True)


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_gymnasium_vectorises_plain_environments(mode):
    env = gym.make_vec(
        "RopeShaping-v1", num_envs=2, vectorization_mode=mode, wrappers=[CPUGymWrapper], sim_backend="cpu", obs_mode="state"
    )
    obs, _ = env.reset(seed=[4, 5])
    assert obs.shape[0] == 2
    env.step(env.action_space.sample())
    env.close()


# ---------------------------------------------------------------- recording and replaying


def record(env, folder, actions, seed):
    """Record one episode per world, with a video, and return the rewards (T, B)."""
    env = RecordEpisode(env, folder, trajectory_name="trajectory", max_steps_per_video=len(actions), video_fps=20)
    env.reset(seed=seed)
    rewards = torch.stack([env.step(action)[1] for action in actions])
    env.reset()
    env.close()
    return rewards


@pytest.mark.parametrize("num_envs", [1, 4])
def test_episodes_are_recorded_and_their_actions_replay_exactly(make_env, draw_actions, tmp_path, num_envs):
    actions, seeds = draw_actions(4, num_envs), list(range(20, 20 + num_envs))
    rewards = record(make_env(num_envs, render_mode="rgb_array"), tmp_path, actions, seeds)
    videos = sorted(tmp_path.glob("*.mp4"))
    frames = imageio.imread(videos[0])
    columns = 2 if num_envs == 4 else 1
    assert len(videos) == 1
    assert frames.shape == (5, 512 * columns, 512 * columns, 3)
    assert frames.std() > 5
    assert (frames[0] != frames[-1]).any()

    data = json.loads((tmp_path / "trajectory.json").read_text())
    assert data["env_info"]["env_id"] == "RopeShaping-v1"
    assert data["env_info"]["max_episode_steps"] == 100
    assert sorted(episode["episode_seed"] for episode in data["episodes"]) == seeds
    env = make_env(1, obs_mode="state_dict+graph")
    with h5py.File(tmp_path / "trajectory.h5") as file:
        for episode in data["episodes"]:
            trajectory = file[f"traj_{episode['episode_id']}"]
            world = seeds.index(episode["episode_seed"])
            check_replay(env, trajectory, episode["episode_seed"], rewards[:, world])


def check_replay(env, trajectory, seed, rewards):
    """Repeat the actions of a recorded trajectory, from its seed and from its first state."""
    states = trajectory_utils.dict_to_list_of_dicts(trajectory["env_states"])
    assert len(states) == len(rewards) + 1
    for from_state in (False, True):
        env.reset(seed=None if from_state else seed)
        if from_state:
            env.unwrapped.set_state_dict(states[0])
        for step, action in enumerate(trajectory["actions"]):
            reward = env.step(action)[1]
            assert float(reward) == trajectory["rewards"][step] == float(rewards[step])
            now = common.to_numpy(env.unwrapped.get_state_dict())
            for group in ("solver", "episode", "articulations", "controller"):
                for name, value in now[group].items():
                    np.testing.assert_array_equal(value[0], states[step + 1][group][name])
    env.unwrapped.set_state_dict(states[2])
    np.testing.assert_array_equal(
        env.unwrapped.get_obs()["graph"]["object"]["position"][0], trajectory["obs/graph/object/position"][2]
    )


def test_recording_survives_partial_resets(make_env, draw_actions, tmp_path):
    env = RecordEpisode(make_env(), tmp_path, trajectory_name="trajectory", save_video=False)
    env = ManiSkillVectorEnv(env)
    env.reset(seed=0)
    env.step(draw_actions(1, 3)[0])
    put_at_goal(env.unwrapped, [2])
    for action in torch.zeros(3, 3, 12):
        env.step(action)
    env.reset()
    env.close()
    data = json.loads((tmp_path / "trajectory.json").read_text())
    steps = sorted((episode["elapsed_steps"], bool(episode["success"])) for episode in data["episodes"])
    assert steps == [(2, False), (2, True), (4, False), (4, False)]


def test_info_is_written_on_videos(make_env, draw_actions, tmp_path):
    env = RecordEpisode(
        make_env(2, render_mode="rgb_array"), tmp_path, save_trajectory=False, info_on_video=True, max_steps_per_video=2
    )
    env.reset(seed=0)
    for action in draw_actions(2, 2):
        env.step(action)
    env.close()
    assert len(list(tmp_path.glob("*.mp4"))) == 1
