"""Whether the state of an environment can be restored."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import torch


def check_restorable(env: gym.Env, action: torch.Tensor) -> None:
    """Refuse an environment that does not come back to a state, or goes on from there in another way.

    Args:
        env: A batched ManiSkill environment, reset; it is left in the state that it is in.
        action: One that changes the state, for all its worlds, (B, D).

    Raises:
        ValueError: Naming the first part of the state that differs.
    """
    base = env.unwrapped
    name = getattr(getattr(base, "spec", None), "id", type(base).__name__)
    if not (hasattr(base, "get_state_dict") and hasattr(base, "set_state_dict")):
        raise ValueError(
            f"{name} cannot be planned in: it has no get_state_dict and set_state_dict, by which plans start from one state"
        )
    states = []
    start = base.get_state_dict()
    for _ in range(2):
        base.set_state_dict(start)
        restored = base.get_state_dict()
        env.step(action)
        states.append((restored, base.get_state_dict()))
    base.set_state_dict(start)
    _expect_equal(start, states[1][0], f"{name} cannot be planned in: set_state_dict does not restore")
    _expect_equal(states[0][1], states[1][1], f"{name} cannot be planned in: one state and action lead to different values of")


def _expect_equal(expected: Mapping[str, Any], found: Mapping[str, Any], message: str, path: str = "") -> None:
    for key, value in expected.items():
        if isinstance(value, Mapping):
            _expect_equal(value, found[key], message, f"{path}{key}/")
        elif not torch.equal(value, found[key]):
            raise ValueError(f"{message} {path}{key}")
