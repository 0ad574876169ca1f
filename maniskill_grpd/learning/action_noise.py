"""Noise that is correlated in time, for exploration."""

from __future__ import annotations

import math

import torch


class ActionNoise:
    """Standard normal noise z_t whose steps are correlated.

        z_t = c z_{t-1} + sqrt(1 - c^2) e_t,    e_t ~ N(0, 1),    z_0 ~ N(0, 1)

    At every step z_t alone is standard normal, so that std * z_t has the policy's own density and log
    probabilities need no correction, as with coloured noise (Hollenstein et al., AAAI 2024). Over n
    steps the sum of z grows like sqrt(n (1 + c) / (1 - c)): with c = 0.8 noise carries a gripper three
    times as far from its way as independent noise of the same density.

    Limitations: given the state, z_t is no longer independent of the past that led there, so policy
    gradients are biased; the larger c, the more.

    Attributes:
        correlation: Correlation c of consecutive steps, in [0, 1); 0 is independent noise.
    """

    def __init__(self, correlation: float = 0.0) -> None:
        self.correlation = correlation
        self._noise: torch.Tensor | None = None

    def restart(self) -> None:
        """Forget the past: the next noise is independent of it."""
        self._noise = None

    def draw(self, like: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
        """Return the noise of the next step, of the shape of `like`.

        Args:
            like: Mean actions (B, A, 3).
            generator: Source of the noise, on the device of `like`.
        """
        fresh = torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)
        past = self._noise
        if self.correlation and past is not None:
            fresh = self.correlation * past + math.sqrt(1.0 - self.correlation**2) * fresh
        self._noise = fresh
        return fresh
