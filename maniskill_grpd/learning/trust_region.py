"""How far a policy has moved from the old one, part by part, and how far it may.

A trust region limits three parts of KL(pi || pi_old): that of the means and that of the covariances
of the Gaussians (eq. 63), and that of the grippers' Bernoulli variables (eq. 56). Bounds are those of
a whole action, summed over its actuators, as eq. 60 has them, or those of each actuator.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal

import torch

from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.policies import ActionDistribution
from maniskill_grpd.policies.divergence import KLParts


@dataclass(frozen=True, kw_only=True)
class BoundOptions(OptionGroup):
    """How far a policy may move in one iteration."""

    RANGES: ClassVar[Mapping[str, str]] = {
        "delta": "(0, inf)",
        "mean_bound": "(0, inf)",
        "cov_bound": "(0, inf)",
        "gripper_bound": "(0, inf)",
    }

    delta: float | None = None
    """bpp: largest KL of the acting policy per iteration, averaged over states [nats]; by default the sum of the bounds"""
    bound_per: Literal["action", "gripper"] = "action"
    """bpp: whether all bounds limit the joint action of all grippers, or each gripper's"""
    mean_bound: float = 0.1
    """bpp: largest mean part of the KL per iteration [nats]; at every state for projection, on average for lagrangian, fisher"""
    cov_bound: float = 0.01
    """bpp: largest covariance part of the KL per iteration [nats]"""
    gripper_bound: float = 0.02
    """bpp: largest part of the KL per iteration of what opens and closes grippers [nats], in tasks with free grasps"""

    @property
    def bounds(self) -> Bounds:
        """The bounds as the algorithms take them."""
        return Bounds(
            mean=self.mean_bound,
            cov=self.cov_bound,
            gripper=self.gripper_bound,
            per_actuator=self.bound_per == "gripper",
            delta=self.delta,
        )


@dataclass(frozen=True, kw_only=True)
class Bounds:
    """Largest parts of the KL [nats].

    Attributes:
        mean: Of the means.
        cov: Of the covariances.
        gripper: Of the grippers.
        per_actuator: Whether they hold for each actuator instead of for the sum over actuators.
        delta: Bound of the average over states of all parts together; None for the sum of the parts' bounds.
    """

    mean: float
    cov: float
    gripper: float
    per_actuator: bool = False
    delta: float | None = None

    def acting(self, dist: ActionDistribution) -> float:
        """Return the bound of the average KL of the policy that acts [nats]."""
        if self.delta is not None:
            return self.delta
        return self.mean + self.cov + (dist.gripper_logits is not None) * self.gripper

    def limited(self, parts: KLParts) -> KLParts:
        """Return what the bounds limit: the parts (M, A) of each actuator, or their sums over actuators (M, 1)."""
        return parts if self.per_actuator else KLParts(*(part.sum(-1, keepdim=True) for part in parts))

    def average(self, dist: ActionDistribution, parts: KLParts) -> KLParts:
        """Return averages of the limited parts, over states or over states and actuators, scalars."""
        count = dist.mask.sum().clamp(min=1) if self.per_actuator else len(dist.mask)
        return KLParts(*(part.sum() / count for part in parts))


def kl_metrics(name: str, parts: KLParts) -> dict[str, torch.Tensor]:
    """Summarise KL(policy || old policy).

    Args:
        name: "raw" or "projected": which policy.
        parts: Its parts.

    Returns:
        `kl_{name}` summed over actuators and averaged over states, its largest value `..._max`, and
        the largest parts of a single actuator.
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
    """Return the share of states, or of (state, actuator) pairs, beyond each bound."""
    count = dist.mask.sum().clamp(min=1) if bounds.per_actuator else len(dist.mask)
    return {
        f"{name}_bound_active": (part > getattr(bounds, name)).sum() / count
        for name, part in bounds.limited(parts)._asdict().items()
    }
