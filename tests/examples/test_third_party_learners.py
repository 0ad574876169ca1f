"""Learners that know nothing of these tasks run on them."""

import gymnasium as gym
import maniskill_ppo
import pytest
import torch
from mani_skill.utils.wrappers import CPUGymWrapper

stable_baselines3_ppo = pytest.importorskip("stable_baselines3_ppo")


@pytest.fixture(autouse=True)
def _keep_threads():
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


def test_stable_baselines3_trains_and_sees_whole_episodes():
    pytest.importorskip("stable_baselines3")
    import stable_baselines3_ppo

    config = stable_baselines3_ppo.Sb3Config(num_envs=8, num_steps=100, total_timesteps=1600, sim_backend="cpu")
    learner = stable_baselines3_ppo.train(config)
    assert learner.num_timesteps == 1600
    episodes = list(learner.ep_info_buffer)
    assert len(episodes) == 16
    assert all(episode["l"] == 100 for episode in episodes)
    assert all(0.0 < episode["r"] < 100.0 for episode in episodes)


def test_stable_baselines3_sees_the_episodes_of_a_single_world_through_its_own_monitor():
    """`CPUGymWrapper(record_metrics=True)` puts metrics of its own into `info["episode"]`, where it looks for "r"."""
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.monitor import Monitor

    env = gym.make("RopeShaping-v1", sim_backend="cpu", obs_mode="state", max_episode_steps=8)
    learner = stable_baselines3.PPO(
        "MlpPolicy", Monitor(CPUGymWrapper(env), info_keywords=("success",)), n_steps=16, batch_size=16
    )
    learner.learn(32)
    assert [episode["l"] for episode in learner.ep_info_buffer] == [8] * 4
    assert not any(episode["success"] for episode in learner.ep_info_buffer)


def test_sac_of_stable_baselines3_learns_from_a_single_world():
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from stable_baselines3.common.monitor import Monitor

    env = gym.make("RopeShaping-v1", sim_backend="cpu", obs_mode="state", max_episode_steps=8)
    settings = {"learning_starts": 16, "buffer_size": 100, "batch_size": 8}
    learner = stable_baselines3.SAC("MlpPolicy", Monitor(CPUGymWrapper(env)), policy_kwargs={"net_arch": [16]}, **settings)
    before = [parameter.clone() for parameter in learner.actor.parameters()]
    learner.learn(24)
    assert [episode["l"] for episode in learner.ep_info_buffer] == [8] * 3
    assert any((a != b).any() for a, b in zip(before, learner.actor.parameters(), strict=True))


def test_ppo_as_in_maniskill_reports_its_metrics():
    config = maniskill_ppo.PpoConfig(
        num_envs=4, num_eval_envs=2, num_steps=20, num_minibatches=4, update_epochs=1, total_timesteps=240, sim_backend="cpu"
    )
    metrics = maniskill_ppo.train(config)
    assert {"success_once", "success_at_end", "return", "episode_len"} <= set(metrics)
    assert metrics["episode_len"] == 100


def test_ppo_as_in_maniskill_bootstraps_from_the_last_observation():
    """Advantages with lambda = 1 are the discounted rewards to the time limit plus the value there, minus the value."""
    config = maniskill_ppo.PpoConfig(num_envs=3, num_steps=104, gae_lambda=1.0, sim_backend="cpu")
    envs = maniskill_ppo.make_envs(config, 3, ignore_terminations=True)
    agent = maniskill_ppo.MlpAgent(envs.single_observation_space.shape[0], 12)
    state, _ = envs.reset(seed=0)
    seen = []
    step = envs.step
    envs.step = lambda action: seen.append(step(action)) or seen[-1]
    rollout, _ = maniskill_ppo.collect(agent, envs, state, config)
    rewards = torch.stack([row[1] for row in seen])[:100]
    discounts = config.gamma ** torch.arange(101.0)
    with torch.no_grad():
        last = agent.value(seen[99][4]["final_observation"])
        expected = (discounts[:100, None] * rewards).sum(0) + discounts[100] * last
    torch.testing.assert_close(rollout["returns"].view(104, 3)[0], expected, rtol=1e-4, atol=1e-4)
    # the episode that follows starts elsewhere
    assert (seen[99][4]["final_observation"] != seen[99][0]).any()
    envs.close()


class PointEnv:
    """Rewards actions close to the observation; episodes end after five steps by a time limit."""

    def step(self, action):
        """Pay and draw the next observation."""
        reward = -(action - self.obs).square().sum(-1)
        self.elapsed, self.obs = self.elapsed + 1, torch.randn(32, 2)
        truncated = torch.full((32,), self.elapsed % 5 == 0)
        return self.obs, reward, torch.zeros(32, dtype=torch.bool), truncated, {"final_observation": self.obs}


def test_ppo_as_in_maniskill_learns():
    torch.manual_seed(0)
    config = maniskill_ppo.PpoConfig(num_envs=32, num_steps=20)
    envs, agent = PointEnv(), maniskill_ppo.MlpAgent(2, 2)
    envs.elapsed, envs.obs = 0, torch.randn(32, 2)
    optimizer = torch.optim.Adam(agent.parameters(), lr=config.learning_rate)
    points, state = torch.randn(500, 2), envs.obs

    def error():
        return (agent.actor(points) - points).square().sum(-1).mean().item()

    before = error()
    for _ in range(8):
        rollout, state = maniskill_ppo.collect(agent, envs, state, config)
        maniskill_ppo.update(agent, optimizer, rollout, config)
    assert error() < 0.8 * before


def test_stable_baselines3_trains_a_convolutional_network_on_depth():
    pytest.importorskip("stable_baselines3")
    import stable_baselines3_depth

    config = stable_baselines3_depth.Sb3DepthConfig(num_envs=4, num_steps=8, image_size=36, total_timesteps=64, sim_backend="cpu")
    learner = stable_baselines3_depth.train(config)
    assert learner.num_timesteps == 64
    assert learner.observation_space.shape == (1, 36, 36)
    images = learner.rollout_buffer.observations
    assert 0.0 < images.min() < images.max() <= 1.0
    assert (images[0] != images[-1]).any()
    assert type(learner.policy.features_extractor).__name__ == "NatureCNN"
