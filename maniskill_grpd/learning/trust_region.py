"""How far a policy has moved from the old one, per actuator and part, and how far it may.

A trust region limits three parts of KL(pi || pi_old) of each actuator: that of the mean and that of
the covariance of its Gaussian (eq. 63), and that of its gripper's Bernoulli variable (eq. 56).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import torch

from maniskill_grpd.learning.projection import kl_parts_unchecked
from maniskill_grpd.learning.rollout import Batch
from maniskill_grpd.policies import ActionDistribution


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Largest parts of the KL of one actuator [nats]."""

    mean: float
    cov: float
    gripper: float


class KLParts(NamedTuple):
    """Parts of KL(pi || reference) of each actuator, (M, A) [nats], zero where masked."""

    mean: torch.Tensor
    cov: torch.Tensor
    gripper: torch.Tensor

    @property
    def total(self) -> torch.Tensor:
        """KL of whole actions, (M,)."""
        return (self.mean + self.cov + self.gripper).sum(-1)


def kl_parts(dist: ActionDistribution, reference: ActionDistribution) -> KLParts:
    """Return the parts of KL(dist || reference).

    Args:
        dist: A policy at M states.
        reference: Another at the same states.
    """
    mean, cov = kl_parts_unchecked(dist.mean, dist.std, reference.mean, reference.std)
    absent = ~dist.mask
    return KLParts(mean.masked_fill(absent, 0.0), cov.masked_fill(absent, 0.0), dist.gripper_kl_divergence(reference))


def old_distribution(dist: ActionDistribution, batch: Batch) -> ActionDistribution:
    """Return the policy that collected a batch, at the batch's states.

    Args:
        dist: The current policy there: gives the mask.
        batch: Transitions.
    """
    return dataclasses.replace(dist, mean=batch.old_mean, std=batch.old_std, gripper_logits=batch.old_gripper_logits)


def detached(dist: ActionDistribution) -> ActionDistribution:
    """Return a distribution through which no gradient flows."""
    logits = dist.gripper_logits
    return dataclasses.replace(
        dist, mean=dist.mean.detach(), std=dist.std.detach(), gripper_logits=None if logits is None else logits.detach()
    )


def kl_metrics(name: str, parts: KLParts) -> dict[str, torch.Tensor]:
    """Summarise KL(policy || old policy).

    Args:
        name: "raw" or "projected": which policy.
        parts: Its parts.

    Returns:
        `kl_{name}` summed over actuators and averaged over states, its largest value `..._max`, and
        the largest parts of a single actuator, which are what the bounds limit.
    """
    total = parts.total
    return {
        f"kl_{name}": total.mean(),
        f"kl_{name}_max": total.max(),
        f"kl_{name}_mean_part_max": parts.mean.max(),
        f"kl_{name}_cov_part_max": parts.cov.max(),
        f"kl_{name}_gripper_part_max": parts.gripper.max(),
    }


def activity_metrics(dist: ActionDistribution, parts: KLParts, bounds: Bounds) -> dict[str, torch.Tensor]:
    """Return the share of (state, actuator) pairs beyond each bound."""
    count = dist.mask.sum().clamp(min=1)
    return {
        f"{name}_bound_active": (part > getattr(bounds, name)).sum() / count
        for name, part in zip(KLParts._fields, parts, strict=True)
    }
