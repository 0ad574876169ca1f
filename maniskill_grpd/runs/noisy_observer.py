"""A policy that sees through noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import torch

from maniskill_grpd.learning.observation_noise import ObservationNoise
from maniskill_grpd.policies import Policy


class NoisyObserver:
    """Acts as a policy does that sees positions and velocities through Gaussian noise (Section III.E).

    The noise is on every node, of the object and of the grippers, and drawn anew at every step; see `ObservationNoise`.

    Args:
        policy: The policy that acts.
        sigma: Standard deviation of each component, of positions [m] and of velocities [m/s].
        generator: Source of the noise, on the device of the observations.

    Raises:
        ValueError: If sigma is negative or not finite.
    """

    def __init__(self, policy: Policy, sigma: float, generator: torch.Generator) -> None:
        if not (math.isfinite(sigma) and sigma >= 0.0):
            raise ValueError(f"sigma must not be negative, got {sigma}")
        self._policy = policy
        self._noise = ObservationNoise(schema=policy.schema, position_std=sigma, velocity_std=sigma)
        self._generator = generator

    def act(
        self, graph: Mapping[str, Any], deterministic: bool = False, generator: torch.Generator | None = None
    ) -> torch.Tensor:
        """Choose actions as `Policy.act` does, on a noisy copy of the graph."""
        noisy = self._noise(graph, self._generator)
        return self._policy.act(noisy, deterministic=deterministic, generator=generator)
