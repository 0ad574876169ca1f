"""The same episodes in other orientations."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import torch

LEAST_TURN = torch.pi / 2
"""Smallest angle of a turn, to either side [rad]; the largest is half a turn."""


class TurnedScene(gym.Wrapper):
    """Turns the worlds of every episode about the vertical through the origin.

    An equivariant policy does in the turned scene what it does in the original one. Angles are
    drawn between a quarter and a half turn to either side, one per world and the same after every
    reset, so that results of different policies can be compared.

    Args:
        env: A batched task, plain.
        seed: Of the angles.
    """

    def __init__(self, env: gym.Env, seed: int = 0) -> None:
        super().__init__(env)
        generator = torch.Generator().manual_seed(seed)
        draws = 2.0 * torch.rand(env.unwrapped.num_envs, generator=generator) - 1.0
        angle = draws.sign() * (LEAST_TURN + (torch.pi - LEAST_TURN) * draws.abs())
        self.rotation = _about_vertical(angle).to(env.unwrapped.device)

    def reset(self, **options: Any) -> tuple[Any, dict]:
        """Start new episodes in all worlds, then turn them."""
        self.env.reset(**options)
        base = self.env.unwrapped
        base.move_worlds(self.rotation, torch.zeros(3))
        info = base.get_info()
        return base.get_obs(info), info


def _about_vertical(angle: torch.Tensor) -> torch.Tensor:
    """Rotation matrices (B, 3, 3) of angles (B,) [rad]."""
    cos, sin, zero = angle.cos(), angle.sin(), torch.zeros_like(angle)
    rows = [cos, -sin, zero, sin, cos, zero, zero, zero, zero + 1.0]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))
