"""Gaussian over the displacements of all actuators."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

_LOG_TWO_PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class ActionDistribution:
    """Independent isotropic Gaussians N(mean, std^2 I), one per actuator (eq. 53, 54).

    Masked actuators have mean zero, sample zero and no share in any sum.

    Attributes:
        mean: (B, A, 3), in units of the largest displacement per step.
        std: (B, A, 1), positive.
        mask: (B, A) bool.
    """

    mean: torch.Tensor
    std: torch.Tensor
    mask: torch.Tensor

    @property
    def mode(self) -> torch.Tensor:
        """Most likely action, (B, A * 3)."""
        return self.mean.masked_fill(~self.mask[..., None], 0.0).flatten(1)

    def sample(self, generator: torch.Generator | None = None) -> torch.Tensor:
        """Draw one action per graph, (B, A * 3), without gradient."""
        with torch.no_grad():
            noise = torch.randn(
                self.mean.shape,
                generator=generator,
                device=self.mean.device,
                dtype=self.mean.dtype,
            )
            action = self.mean + self.std * noise
            return action.masked_fill(~self.mask[..., None], 0.0).flatten(1)

    def log_prob(self, action: torch.Tensor) -> torch.Tensor:
        """Log density [nats] summed over actuators.

        Args:
            action: (B, A * 3) or (B, A, 3).

        Returns:
            (B,).
        """
        action = action.reshape(self.mean.shape)
        squared = ((action - self.mean) / self.std).square().sum(-1)
        dims = self.mean.shape[-1]
        log_prob = -0.5 * (squared + dims * _LOG_TWO_PI) - dims * self.std.squeeze(-1).log()
        return self._sum(log_prob)

    def entropy(self) -> torch.Tensor:
        """Differential entropy [nats] summed over actuators, (B,)."""
        dims = self.mean.shape[-1]
        return self._sum(dims * (0.5 * (1.0 + _LOG_TWO_PI) + self.std.squeeze(-1).log()))

    def kl_divergence(self, old: ActionDistribution) -> tuple[torch.Tensor, torch.Tensor]:
        """KL(self || old) of each actuator in its two parts (eq. 63); their sum is the divergence.

        With d = 3 and ratio q = (std / old.std)^2:

            mean part        |mean - old.mean|^2 / (2 old.std^2)
            covariance part  d (q - 1 - log q) / 2

        Args:
            old: The reference, of the same shapes.

        Returns:
            Mean part and covariance part [nats], each (B, A) and zero where masked.
        """
        mean = 0.5 * ((self.mean - old.mean) / old.std).square().sum(-1)
        log_ratio = 2.0 * (self.std.log() - old.std.log()).squeeze(-1)
        # expm1: near equality q - 1 - log q cancels, and that is where trust regions live.
        covariance = 0.5 * self.mean.shape[-1] * (torch.expm1(log_ratio) - log_ratio)
        return mean.masked_fill(~self.mask, 0.0), covariance.masked_fill(~self.mask, 0.0)

    def _sum(self, per_actuator: torch.Tensor) -> torch.Tensor:
        return per_actuator.masked_fill(~self.mask, 0.0).sum(-1)
