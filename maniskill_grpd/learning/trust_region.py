"""How far a policy has moved from the old one, per actuator and part, and how far it may.

A trust region limits three parts of KL(pi || pi_old) of each actuator: that of the mean and that of
the covariance of its Gaussian (eq. 63), and that of its gripper's Bernoulli variable (eq. 56).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import torch

from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.policies import ActionDistribution
from maniskill_grpd.policies.divergence import KLParts


@dataclass(frozen=True, kw_only=True)
class BoundOptions(OptionGroup):
    """How far a policy may move in one iteration."""

    RANGES: ClassVar[Mapping[str, str]] = {"mean_bound": "(0, inf)", "cov_bound": "(0, inf)", "gripper_bound": "(0, inf)"}

    mean_bound: float = 0.05
    """bpp: largest mean part of the KL of an actuator per iteration [nats]; on average for lagrangian, fisher"""
    cov_bound: float = 0.005
    """bpp: largest covariance part of the KL of an actuator per iteration [nats]"""
    gripper_bound: float = 0.01
    """bpp: largest KL of an actuator's gripper per iteration [nats], in tasks with free grasps"""

    @property
    def bounds(self) -> Bounds:
        """The bounds as the algorithms take them."""
        return Bounds(mean=self.mean_bound, cov=self.cov_bound, gripper=self.gripper_bound)


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Largest parts of the KL of one actuator [nats]."""

    mean: float
    cov: float
    gripper: float


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
