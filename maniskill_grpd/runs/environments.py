"""The environments of a run, from its options."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

from maniskill_grpd.learning import TrainConfig


def make_env(config: TrainConfig, num_envs: int, **options: Any) -> gym.Env:
    """Make the task of a run as a plain batched ManiSkill environment.

    Args:
        config: Names the task, its options and the simulation backend.
        num_envs: Number of environments.
        **options: Further options of the task, which replace those of the config.
    """
    given = {"obs_mode": "graph", **config.env_options, **options}
    return gym.make(
        config.env_id,
        num_envs=num_envs,
        sim_backend=config.sim_backend,
        # Resets that happen by themselves must follow from the seeds too, or no run can be repeated.
        enhanced_determinism=True,
        **given,
    )


def make_vector_env(config: TrainConfig, num_envs: int, *, partial_reset: bool) -> ManiSkillVectorEnv:
    """Make the task of a run as a vector environment that resets itself.

    Args:
        config: Names the task, its options and the simulation backend.
        num_envs: Number of environments.
        partial_reset: Whether an episode ends when its environment terminates.
    """
    env = make_env(config, num_envs)
    return ManiSkillVectorEnv(env, num_envs, ignore_terminations=not partial_reset, record_metrics=True)
