"""Train PPO of Stable-Baselines3 on a task: state observations, flat actions, ManiSkill's own adapter.

pip install -e ".[sb3]"
python examples/stable_baselines3_ppo.py --env_id RopeShaping-v1 --total_timesteps 200_000

A single world goes without the adapter: `Monitor(CPUGymWrapper(env))`. Not with `CPUGymWrapper(record_metrics=True)`, whose
metrics stand where Stable-Baselines3 looks for its own.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium as gym
import numpy as np
import torch
import tyro
from mani_skill.vector.wrappers.sb3 import ManiSkillSB3VectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnvWrapper, VecMonitor

import maniskill_grpd  # noqa: F401  (registers the tasks)


@dataclass(frozen=True, kw_only=True)
class Sb3Config:
    """Options of the training."""

    env_id: str = "RopeShaping-v1"
    """id of the task"""
    num_envs: int = 64
    """number of worlds"""
    num_steps: int = 100
    """steps of each world per update"""
    total_timesteps: int = 200_000
    """environment steps of the whole training"""
    seed: int = 1
    """seed of the network, the actions and the worlds"""
    sim_backend: str = "auto"
    """auto (cuda if there is a GPU), cpu or cuda"""


class BatchAttributes(gym.Wrapper):
    """Shows what the adapter reads from the environment: since gymnasium 1.0 wrappers hide it."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        self.num_envs = env.unwrapped.num_envs
        self.single_observation_space = env.unwrapped.single_observation_space
        self.single_action_space = env.unwrapped.single_action_space


class WithoutStatistics(VecEnvWrapper):
    """Drops the adapter's episode statistics: it reports them at every step, and zeros where an episode ends."""

    def reset(self) -> np.ndarray:
        """Reset all worlds."""
        return self.venv.reset()

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict]]:
        """Finish a step."""
        obs, rewards, dones, infos = self.venv.step_wait()
        for info in infos:
            info.pop("episode", None)
        return obs, rewards, dones, infos


def train(config: Sb3Config) -> PPO:
    """Train as configured and return the learner."""
    torch.set_num_threads(1)
    env = gym.make(config.env_id, num_envs=config.num_envs, obs_mode="state", sim_backend=config.sim_backend)
    vector_env = VecMonitor(WithoutStatistics(ManiSkillSB3VectorEnv(BatchAttributes(env))))
    learner = PPO(
        "MlpPolicy",
        vector_env,
        n_steps=config.num_steps,
        batch_size=config.num_envs * config.num_steps // 8,
        n_epochs=5,
        gamma=0.99,
        seed=config.seed,
        device="cpu",  # an MLP of this size is fastest there
        verbose=1,
    )
    learner.learn(config.total_timesteps, progress_bar=False)
    vector_env.close()
    return learner


def main(arguments: Sequence[str]) -> None:
    """Parse the command line and train."""
    train(tyro.cli(Sb3Config, args=list(arguments), description=__doc__))


if __name__ == "__main__":
    main(sys.argv[1:])
