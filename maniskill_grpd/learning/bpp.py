"""Bounded Policy Projection: a policy gradient through a KL trust-region projection (paper II-E)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import torch

from maniskill_grpd.learning.divergence import kl_metrics, sum_over_actuators
from maniskill_grpd.learning.projection import gaussian_kl_parts, project_gaussian
from maniskill_grpd.learning.rollout import Batch


@dataclass(frozen=True, kw_only=True)
class BPP:
    """Maximise the surrogate (eq. 9, 65) of the projected policy.

        loss = -E[ pi_p(a|s) / pi_old(a|s) A ] + trust_region_coef E[ KL(pi || stopgrad(pi_p)) ]
               - ent_coef E[ H(pi_p) ]

    pi_p is pi projected actuator by actuator (`projection.project_gaussian`), so eq. 10 and 60 hold
    at every state for the policy that is optimised. What acts in the next rollout is pi itself; the
    second term draws it back to pi_p, and is the only gradient where the projection is active along
    a clamped direction.

    Limitations: the bound on pi itself is therefore soft. `kl_raw_*` shows how well it is kept.
    """

    mean_bound: float
    cov_bound: float
    trust_region_coef: float
    ent_coef: float

    def policy_loss(self, dist: Any, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Compute the loss of a minibatch; see `algorithm.Algorithm`."""
        mean, std = project_gaussian(
            dist.mean,
            dist.std,
            batch.old_mean,
            batch.old_std,
            mean_bound=self.mean_bound,
            cov_bound=self.cov_bound,
        )
        projected = dataclasses.replace(dist, mean=mean, std=std)
        log_ratio = projected.log_prob(batch.actions) - batch.log_probs
        surrogate_loss = -(log_ratio.exp() * batch.advantages).mean()
        distance = sum(gaussian_kl_parts(dist.mean, dist.std, mean.detach(), std.detach()))
        trust_region_loss = sum_over_actuators(distance, dist.mask).mean()
        entropy = projected.entropy().mean()
        loss = surrogate_loss + self.trust_region_coef * trust_region_loss - self.ent_coef * entropy
        metrics = {
            "policy_loss": surrogate_loss.detach(),
            "trust_region_loss": trust_region_loss.detach(),
            "entropy": entropy.detach(),
            **self._trust_region_metrics(dist, projected, batch),
        }
        return loss, metrics

    @torch.no_grad()
    def _trust_region_metrics(
        self, dist: Any, projected: Any, batch: Batch
    ) -> dict[str, torch.Tensor]:
        """Return KLs to the old policy before and after projection, and how often a bound is active."""
        raw = gaussian_kl_parts(dist.mean, dist.std, batch.old_mean, batch.old_std)
        bounded = gaussian_kl_parts(projected.mean, projected.std, batch.old_mean, batch.old_std)
        count = dist.mask.sum().clamp(min=1)
        return {
            **kl_metrics("raw", *raw, dist.mask),
            **kl_metrics("projected", *bounded, dist.mask),
            "mean_bound_active": ((raw[0] > self.mean_bound) & dist.mask).sum() / count,
            "cov_bound_active": ((raw[1] > self.cov_bound) & dist.mask).sum() / count,
        }
