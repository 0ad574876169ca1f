"""Kullback-Leibler divergences between the distributions of actions, accurate where trust regions live: near zero."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch.nn.functional import softplus


class KLParts(NamedTuple):
    """Parts of KL(pi || reference) of each actuator, (B, A) [nats], zero where masked."""

    mean: torch.Tensor
    cov: torch.Tensor
    gripper: torch.Tensor

    @property
    def total(self) -> torch.Tensor:
        """KL of whole actions, (B,)."""
        return (self.mean + self.cov + self.gripper).sum(-1)


def gaussian_kl_parts(
    mean: torch.Tensor, std: torch.Tensor, old_mean: torch.Tensor, old_std: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the mean and the covariance part of KL(N(mean, std^2) || N(old_mean, old_std^2)).

    Their sum is the divergence of eq. 63.

    Args:
        mean: Means, (..., d).
        std: Standard deviations, (..., d) or, for sigma^2 I, (..., 1).
        old_mean: Means of the second Gaussian, shape of `mean`.
        old_std: Standard deviations of the second Gaussian, shape of `std`.

    Returns:
        Mean part and covariance part, each (...) [nats].
    """
    return kl_mean(mean, old_mean, old_std), kl_cov(std, old_std, mean.shape[-1])


def kl_mean(mean: torch.Tensor, old_mean: torch.Tensor, old_std: torch.Tensor) -> torch.Tensor:
    """Return 1/2 sum_i (mean_i - old_mean_i)^2 / old_std_i^2, (...) [nats]; shapes as in `gaussian_kl_parts`."""
    return 0.5 * ((mean - old_mean) / old_std).square().sum(-1)


def kl_cov(std: torch.Tensor, old_std: torch.Tensor, dim: int) -> torch.Tensor:
    """Return 1/2 sum_i (x_i - log(1 + x_i)), x = std^2 / old_std^2 - 1, computed in float64.

    Near the old policy the sum is x^2 / 4 while its terms are of order x: float32 has no digits left.

    Args:
        std: (..., d) or (..., 1).
        old_std: Shape of `std`.
        dim: d.
    """
    new, old = std.double(), old_std.double()
    excess = (new - old) * (new + old) / old.square()
    # std far below old_std: 1 + excess has lost the ratio, its logarithm must come from std itself.
    log_ratio = torch.where(excess > -0.5, torch.log1p(excess.clamp_min(-0.5)), 2.0 * (new.log() - old.log()))
    copies = dim if std.shape[-1] == 1 else 1
    return (0.5 * copies * (excess - log_ratio).sum(-1)).to(std.dtype)


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
