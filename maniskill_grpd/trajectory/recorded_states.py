"""An environment that goes through recorded states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import torch


class RecordedStates(gym.Wrapper):
    """Puts the worlds into given states, one for the reset and one after each step.

    What the environment returns is measured in the given state. After the last one it simulates.
    """

    def __init__(self, env: gym.Env) -> None:
        """Wrap a batched environment of ManiSkill, under whatever records it."""
        super().__init__(env)
        self._states: Sequence[dict[str, Any]] = ()
        self._next = 0

    def follow(self, states: Sequence[dict[str, Any]]) -> None:
        """Go through states from the next reset on; leaves (B, D)."""
        self._states = states

    def reset(self, **arguments: Any) -> tuple[Any, dict]:
        """Reset all worlds, to the first state."""
        obs, info = self.env.reset(**arguments)
        self._next = 0
        if not self._restore_next():
            return obs, info
        base = self.unwrapped
        return base.get_obs(info | base.get_info()), info | base.get_info()

    def step(self, action: Any) -> tuple[Any, torch.Tensor, torch.Tensor, torch.Tensor, dict]:
        """Take a step, and go to the next state."""
        obs, reward, terminated, truncated, info = self.env.step(action)
        if not self._restore_next():
            return obs, reward, terminated, truncated, info
        base = self.unwrapped
        info = base.get_info()
        obs = base.get_obs(info, unflattened=True)
        reward = base.get_reward(obs=obs, action=action, info=info)
        return base._flatten_raw_obs(obs), reward, info["success"] | info["fail"], truncated, info

    def _restore_next(self) -> bool:
        """Set the next state, if there is one."""
        if self._next >= len(self._states):
            return False
        self.unwrapped.set_state_dict(self._states[self._next])
        self._next += 1
        return True
