"""Proximal Policy Optimisation with a clipped surrogate, the baseline of BPP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch

from maniskill_grpd.learning.divergence import kl_metrics
from maniskill_grpd.learning.projection import gaussian_kl_parts
from maniskill_grpd.learning.rollout import Batch


@dataclass(frozen=True, kw_only=True)
class PPO:
    """Maximise the clipped surrogate (Schulman et al. 2017, eq. 7).

    loss = -E[ min(ratio A, clip(ratio, 1 - clip_coef, 1 + clip_coef) A) ] - ent_coef E[ H(pi) ]
    """

    clip_coef: float
    ent_coef: float

    def policy_loss(self, dist: Any, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Compute the loss of a minibatch; see `algorithm.Algorithm`."""
        ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
        clipped = ratio.clamp(1.0 - self.clip_coef, 1.0 + self.clip_coef)
        surrogate_loss = -torch.minimum(ratio * batch.advantages, clipped * batch.advantages).mean()
        entropy = dist.entropy().mean()
        with torch.no_grad():
            shift = gaussian_kl_parts(dist.mean, dist.std, batch.old_mean, batch.old_std)
            metrics = {
                "policy_loss": surrogate_loss.detach(),
                "entropy": entropy.detach(),
                "clipfrac": ((ratio - 1.0).abs() > self.clip_coef).float().mean(),
                **kl_metrics("raw", *shift, dist.mask),
            }
        return surrogate_loss - self.ent_coef * entropy, metrics
