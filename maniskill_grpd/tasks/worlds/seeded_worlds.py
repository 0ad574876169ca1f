"""Resets of all worlds or of some, with a seed for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.envs.utils.randomization.batched_rng import BatchedRNG
from mani_skill.utils import common

from maniskill_grpd.tasks.options.seeds import expand_seeds


class SeededWorlds(BaseEnv):
    """The part of an environment that resets its worlds: which, and with which random numbers."""

    def reset(self, seed: int | Sequence[int] | None = None, options: dict | None = None) -> tuple[Any, dict]:
        """Start new episodes in all worlds, or in those of `options["env_idx"]`.

        Args:
            seed: One seed for each world being reset; one number seeds the first, the others follow
                from it. None goes on with the random numbers of each world.
            options: As ManiSkill's `BaseEnv.reset` understands them. `env_idx` is indices (b,) or a mask (B,) of worlds; if it
                names none, nothing happens.

        Raises:
            ValueError: If a seed is no whole number, their number fits neither, or there is no such world.
        """
        worlds = None if options is None else options.get("env_idx")
        if worlds is not None:
            worlds = self._world_indices(worlds)
            options = {**options, "env_idx": worlds}
        seeds = None if seed is None else expand_seeds(seed, self.num_envs if worlds is None else len(worlds))
        self._adopt_compute_device()
        if worlds is not None and not len(worlds):
            info = self.get_info()
            return self.get_obs(info), info | {"reconfigure": False}
        if seeds is None:
            return super().reset(options=options)
        if worlds is None:
            gym.Env.reset(self, seed=seeds[0])  # sets `np_random`, for those who draw from it
            return super().reset(seed=seeds, options=options)
        self._seed_worlds(seeds, common.to_numpy(worlds))
        determinism, self._enhanced_determinism = self._enhanced_determinism, False
        try:
            return super().reset(options=options)
        finally:
            self._enhanced_determinism = determinism

    def _seed_worlds(self, seeds: list[int], worlds: np.ndarray) -> None:
        """Seed some worlds. ManiSkill would seed all, and so change the others' next episodes."""
        self._batched_main_rng[worlds] = BatchedRNG.from_seeds(seeds).rngs
        self._batched_episode_rng[worlds] = BatchedRNG.from_seeds(seeds).rngs
        self._episode_seed[worlds] = seeds
