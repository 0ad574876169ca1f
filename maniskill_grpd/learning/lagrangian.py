"""Bounded policy updates by Lagrangian duality (paper eq. 66)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from maniskill_grpd.learning.rollout import Batch, Rollout
from maniskill_grpd.learning.trust_region import BoundOptions, Bounds, activity_metrics, kl_metrics
from maniskill_grpd.learning.update import FirstOrderAlgorithm, Learner, Metrics
from maniskill_grpd.policies import ActionDistribution
from maniskill_grpd.policies.divergence import KLParts

if TYPE_CHECKING:
    from maniskill_grpd.learning.config import TrainConfig

_FIRST_MULTIPLIER = 1.0


@dataclass(frozen=True, kw_only=True)
class LagrangianOptions(BoundOptions):
    """Options of the Lagrangian."""

    RANGES: ClassVar[Mapping[str, str]] = {"dual_step": "(0, inf)", "max_multiplier": "(1, inf)"}

    dual_step: float = 0.5
    """lagrangian: step of the dual ascent on the logarithm of a multiplier, per iteration"""
    max_multiplier: float = 100.0
    """lagrangian: largest multiplier; the smallest is its inverse"""


@dataclass(kw_only=True)
class LagrangianBPP(FirstOrderAlgorithm):
    """Maximise the surrogate minus multiples of the KL: `--trust_region lagrangian`.

        loss = -E[ ratio A ] + sum_k lambda_k (E[KL_k] / bound_k - 1) - ent_coef E[ H(pi) ]

    with k the mean, the covariance and the gripper part of the KL, averaged over states.
    After each update, dual ascent on log lambda_k,

        lambda_k <- clip(lambda_k exp(dual_step clip(E[KL_k] / bound_k - 1, -1, 1)), 1/max, max)

    with the KL of the last epoch. Ascent on the logarithm needs no scale and keeps the multipliers
    positive; the bounds keep a long time inside or outside the region from winding them up.

    Limitations: the bounds hold on average over states, and only once the multipliers have settled.
    """

    bounds: Bounds
    dual_step: float
    max_multiplier: float
    multipliers: dict[str, float] = field(default_factory=lambda: dict.fromkeys(KLParts._fields, _FIRST_MULTIPLIER))

    @classmethod
    def from_config(cls, config: TrainConfig) -> LagrangianBPP:
        """See `Algorithm.from_config`."""
        return cls(
            bounds=config.bounds, dual_step=config.dual_step, max_multiplier=config.max_multiplier, ent_coef=config.ent_coef
        )

    def acting_bound(self, old: ActionDistribution) -> tuple[float, bool]:
        """See `Algorithm.acting_bound`."""
        return self.bounds.acting(old), self.bounds.per_actuator

    def policy_loss(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> tuple[torch.Tensor, Metrics]:
        """See `FirstOrderAlgorithm.policy_loss`."""
        ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
        surrogate_loss = -(ratio * batch.advantages).mean()
        penalties = {
            name: self.multipliers[name] * (share - 1.0) for name, share in self._shares(dist, dist.kl_parts(batch.old)).items()
        }
        entropy = dist.entropy().mean()
        penalty = sum(penalties.values())
        metrics = {"policy_loss": surrogate_loss.detach(), "trust_region_loss": penalty.detach(), "entropy": entropy.detach()}
        return surrogate_loss + penalty - self.ent_coef * entropy, metrics

    @torch.no_grad()
    def diagnose(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> Metrics:
        """See `FirstOrderAlgorithm.diagnose`: KLs and their shares of the bounds."""
        parts = dist.kl_parts(batch.old)
        shares = self._shares(dist, parts)
        return {
            **kl_metrics("raw", parts),
            **activity_metrics(dist, parts, self.bounds),
            **{f"{name}_bound_share": share for name, share in shares.items()},
        }

    def update(self, learner: Learner, rollout: Rollout) -> dict[str, float]:
        """Update the policy, then the multipliers; see `Algorithm.update`."""
        metrics = super().update(learner, rollout)
        metrics |= {f"{name}_multiplier": value for name, value in self.multipliers.items()}
        for name in self.multipliers:
            self.ascend(name, metrics[f"{name}_bound_share"])
        return metrics

    def ascend(self, name: str, share: float) -> None:
        """Take one step of dual ascent.

        Args:
            name: "mean", "cov" or "gripper".
            share: KL of that part over its bound.
        """
        step = self.dual_step * min(max(share - 1.0, -1.0), 1.0)
        raised = self.multipliers[name] * math.exp(step)
        self.multipliers[name] = min(max(raised, 1.0 / self.max_multiplier), self.max_multiplier)

    def state_dict(self) -> dict[str, Any]:
        """See `Algorithm.state_dict`."""
        return {"multipliers": dict(self.multipliers)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """See `Algorithm.load_state_dict`."""
        self.multipliers = {name: float(state["multipliers"][name]) for name in KLParts._fields}

    def _shares(self, dist: ActionDistribution, parts: KLParts) -> dict[str, torch.Tensor]:
        """Return each part, on average, over its bound."""
        averages = self.bounds.average(dist, parts)
        return {name: part / getattr(self.bounds, name) for name, part in averages._asdict().items()}
