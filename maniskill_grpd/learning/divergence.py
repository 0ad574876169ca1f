"""Divergences of policies made of one Gaussian per actuator."""

from __future__ import annotations

import torch


def sum_over_actuators(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Sum a quantity per actuator, (M, A), over the actuators that exist, to (M,).

    Args:
        values: (M, A).
        mask: Whether an actuator exists, bool (M, A).
    """
    return torch.where(mask, values, torch.zeros_like(values)).sum(-1)


def kl_metrics(
    name: str, kl_mean: torch.Tensor, kl_cov: torch.Tensor, mask: torch.Tensor
) -> dict[str, torch.Tensor]:
    """Summarise KL(policy || old policy) per actuator and in total.

    Args:
        name: "raw" or "projected": which policy.
        kl_mean: Mean part of each actuator, (M, A) [nats].
        kl_cov: Covariance part of each actuator, (M, A) [nats].
        mask: Whether an actuator exists, bool (M, A).

    Returns:
        `kl_{name}` summed over actuators and averaged over states, its largest value `..._max`, and
        the largest parts of a single actuator, which are what the bounds limit.
    """
    total = sum_over_actuators(kl_mean + kl_cov, mask)
    zero = torch.zeros_like(kl_mean)
    return {
        f"kl_{name}": total.mean(),
        f"kl_{name}_max": total.max(),
        f"kl_{name}_mean_part_max": torch.where(mask, kl_mean, zero).max(),
        f"kl_{name}_cov_part_max": torch.where(mask, kl_cov, zero).max(),
    }
