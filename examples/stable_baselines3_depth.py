"""Train PPO of Stable-Baselines3 with a convolutional network on images of depth, drawn without a graphics driver.

pip install -e ".[sb3]"
python examples/stable_baselines3_depth.py --env_id RopeWrapping-v1 --total_timesteps 20_000

The network sees one image of depth and nothing else: no node, no velocity, no description of the goal. In RopeWrapping-v1 and
ClothHanging-v1 what has to be done can be seen: the post and the hanger are in the image.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from mani_skill.vector.wrappers.sb3 import ManiSkillSB3VectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecMonitor
from stable_baselines3_ppo import WithoutStatistics

import maniskill_grpd  # noqa: F401  (registers the tasks)

CAMERA = "base_camera"
NEAREST, FARTHEST = 500.0, 2000.0
"""Depths that become 0 and 1 [mm]."""


@dataclass(frozen=True, kw_only=True)
class Sb3DepthConfig:
    """Options of the training."""

    env_id: str = "RopeWrapping-v1"
    """id of the task"""
    num_envs: int = 32
    """number of worlds"""
    num_steps: int = 100
    """steps of each world per update"""
    image_size: int = 64
    """height and width of the images [pixels], at least 36 for this network"""
    total_timesteps: int = 20_000
    """environment steps of the whole training"""
    seed: int = 1
    """seed of the network, the actions and the worlds"""
    sim_backend: str = "auto"
    """auto (cuda if there is a GPU), cpu or cuda"""


class DepthImages(gym.Wrapper):
    """Observes images (B, 1, H, W) in [0, 1]; what is nowhere is as far as can be."""

    def __init__(self, env: gym.Env) -> None:
        super().__init__(env)
        height, width, _ = env.unwrapped.single_observation_space["sensor_data"][CAMERA]["depth"].shape
        self.num_envs = env.unwrapped.num_envs
        self.single_action_space = env.unwrapped.single_action_space
        self.single_observation_space = gym.spaces.Box(0.0, 1.0, (1, height, width), np.float32)

    def reset(self, **options: Any) -> tuple[torch.Tensor, dict]:
        """Reset worlds; images of all."""
        obs, info = self.env.reset(**options)
        return to_image(obs), info

    def step(self, action: np.ndarray) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict]:
        """Take a step."""
        obs, *rest = self.env.step(action)
        return to_image(obs), *rest


def to_image(obs: dict[str, Any]) -> torch.Tensor:
    """Return the depth of an observation, (B, 1, H, W) float32 in [0, 1]."""
    depth = obs["sensor_data"][CAMERA]["depth"].permute(0, 3, 1, 2).float()
    depth = torch.where(depth > 0.0, depth, FARTHEST)
    return ((depth - NEAREST) / (FARTHEST - NEAREST)).clamp(0.0, 1.0)


def train(config: Sb3DepthConfig) -> PPO:
    """Train as configured and return the learner."""
    torch.set_num_threads(1)
    size = {"width": config.image_size, "height": config.image_size}
    env = gym.make(config.env_id, num_envs=config.num_envs, obs_mode="depth", sensor_configs=size, sim_backend=config.sim_backend)
    vector_env = VecMonitor(WithoutStatistics(ManiSkillSB3VectorEnv(DepthImages(env))))
    learner = PPO(
        "CnnPolicy",
        vector_env,
        n_steps=config.num_steps,
        batch_size=config.num_envs * config.num_steps // 8,
        n_epochs=3,
        gamma=0.99,
        seed=config.seed,
        policy_kwargs={"normalize_images": False, "features_extractor_kwargs": {"normalized_image": True}},
        device="cuda" if env.unwrapped.device.type == "cuda" else "cpu",
        verbose=1,
    )
    learner.learn(config.total_timesteps, progress_bar=False)
    vector_env.close()
    return learner


def main(arguments: Sequence[str]) -> None:
    """Parse the command line and train."""
    train(tyro.cli(Sb3DepthConfig, args=list(arguments), description=__doc__))


if __name__ == "__main__":
    main(sys.argv[1:])
