"""Distribution over the actions of all actuators."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch.nn.functional import logsigmoid, softplus

_LOG_TWO_PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class ActionDistribution:
    """Independent isotropic Gaussians N(mean, std^2 I), one per actuator (eq. 53, 54).

    With grippers each actuator has a Bernoulli variable g beside it (eq. 56): 1 closes, 0 opens.
    An action then holds (x, y, z, g) per actuator, and every density, entropy and divergence is
    that of the joint distribution. Shapes below have E = 3 entries per actuator, or 4 with gripper.

    Masked actuators have mean zero, sample zero and no share in any sum.

    Attributes:
        mean: (B, A, 3), in units of the largest displacement per step.
        std: (B, A, 1), positive.
        mask: (B, A) bool.
        gripper_logits: Log-odds of g = 1, (B, A); None without grippers.
    """

    mean: torch.Tensor
    std: torch.Tensor
    mask: torch.Tensor
    gripper_logits: torch.Tensor | None = None

    @property
    def mode(self) -> torch.Tensor:
        """Most likely action, (B, A * E)."""
        action = self.mean
        if self.gripper_logits is not None:
            closed = (self.gripper_logits > 0).to(action.dtype)
            action = torch.cat([action, closed[..., None]], dim=-1)
        return action.masked_fill(~self.mask[..., None], 0.0).flatten(1)

    def sample(self, generator: torch.Generator | None = None, noise: torch.Tensor | None = None) -> torch.Tensor:
        """Draw one action per graph, (B, A * E), without gradient.

        Args:
            generator: Source of what is drawn.
            noise: Standard normal noise (B, A, 3) of the Gaussians; by default it is drawn.
        """
        with torch.no_grad():
            if noise is None:
                noise = torch.randn(self.mean.shape, generator=generator, device=self.mean.device, dtype=self.mean.dtype)
            action = self.mean + self.std * noise
            if self.gripper_logits is not None:
                probability = torch.sigmoid(self.gripper_logits)
                closed = torch.bernoulli(probability, generator=generator)
                action = torch.cat([action, closed[..., None]], dim=-1)
            return action.masked_fill(~self.mask[..., None], 0.0).flatten(1)

    def log_prob(self, action: torch.Tensor) -> torch.Tensor:
        """Log density [nats] summed over actuators.

        Args:
            action: (B, A * E) or (B, A, E).

        Returns:
            (B,).
        """
        dims = self.mean.shape[-1]
        action = action.reshape(*self.mean.shape[:-1], dims + (self.gripper_logits is not None))
        squared = ((action[..., :dims] - self.mean) / self.std).square().sum(-1)
        log_prob = -0.5 * (squared + dims * _LOG_TWO_PI) - dims * self.std.squeeze(-1).log()
        if self.gripper_logits is not None:
            closed, logits = action[..., dims], self.gripper_logits
            log_prob = log_prob + closed * logsigmoid(logits) + (1 - closed) * logsigmoid(-logits)
        return self._sum(log_prob)

    def entropy(self) -> torch.Tensor:
        """Entropy [nats] summed over actuators, (B,): differential, of grippers discrete."""
        dims = self.mean.shape[-1]
        entropy = dims * (0.5 * (1.0 + _LOG_TWO_PI) + self.std.squeeze(-1).log())
        if self.gripper_logits is not None:
            logits = self.gripper_logits
            # H = p softplus(-l) + (1 - p) softplus(l), whose terms never are 0 * inf.
            probability = torch.sigmoid(logits)
            entropy = entropy + softplus(logits) - probability * logits
        return self._sum(entropy)

    def kl_divergence(self, old: ActionDistribution) -> tuple[torch.Tensor, torch.Tensor]:
        """KL(self || old) of each actuator's Gaussian in its two parts (eq. 63).

        With d = 3 and ratio q = (std / old.std)^2:

            mean part        |mean - old.mean|^2 / (2 old.std^2)
            covariance part  d (q - 1 - log q) / 2

        Their sum is the divergence; with grippers `gripper_kl_divergence` comes on top.

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

    def gripper_kl_divergence(self, old: ActionDistribution) -> torch.Tensor:
        """KL(self || old) of each gripper's Bernoulli variable [nats], (B, A), zero where masked.

        Zero without grippers.

        Args:
            old: The reference, of the same shapes.
        """
        if self.gripper_logits is None or old.gripper_logits is None:
            return torch.zeros_like(self.mean[..., 0])
        kl = bernoulli_kl(self.gripper_logits, old.gripper_logits)
        return kl.masked_fill(~self.mask, 0.0)

    def joint_kl_divergence(self, old: ActionDistribution) -> torch.Tensor:
        """KL(self || old) of whole actions [nats], grippers included, (B,)."""
        mean, covariance = self.kl_divergence(old)
        return (mean + covariance + self.gripper_kl_divergence(old)).sum(-1)

    def _sum(self, per_actuator: torch.Tensor) -> torch.Tensor:
        return per_actuator.masked_fill(~self.mask, 0.0).sum(-1)


def bernoulli_kl(logits: torch.Tensor, old_logits: torch.Tensor) -> torch.Tensor:
    """KL between two Bernoulli variables [nats], of any shape.

        p (l - k) - log((1 + exp(l)) / (1 + exp(k))),      p = sigmoid(l)

    Args:
        logits: Log-odds l of the first variable.
        old_logits: Log-odds k of the second, same shape.
    """
    change = logits - old_logits
    # Close to each other, the difference of two softplus would lose the quadratic remainder.
    near = change.clamp(-1.0, 1.0)
    log_ratio = torch.where(
        change.abs() < 1.0, torch.log1p(torch.sigmoid(old_logits) * torch.expm1(near)), softplus(logits) - softplus(old_logits)
    )
    return (torch.sigmoid(logits) * change - log_ratio).clamp(min=0.0)
