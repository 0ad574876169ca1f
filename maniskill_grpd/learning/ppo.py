"""Proximal Policy Optimisation with a clipped surrogate, the baseline of BPP."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import torch

from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.learning.rollout import Batch
from maniskill_grpd.learning.trust_region import kl_metrics
from maniskill_grpd.learning.update import FirstOrderAlgorithm, Metrics
from maniskill_grpd.policies import ActionDistribution

if TYPE_CHECKING:
    from maniskill_grpd.learning.config import TrainConfig


@dataclass(frozen=True, kw_only=True)
class PPOOptions(OptionGroup):
    """Options of PPO."""

    RANGES: ClassVar[Mapping[str, str]] = {"clip_coef": "(0, inf)"}

    clip_coef: float = 0.2
    """ppo: clipping of the probability ratio"""


@dataclass(kw_only=True)
class PPO(FirstOrderAlgorithm):
    """Maximise the clipped surrogate (Schulman et al. 2017, eq. 7).

    loss = -E[ min(ratio A, clip(ratio, 1 - clip_coef, 1 + clip_coef) A) ] - ent_coef E[ H(pi) ]
    """

    Options: ClassVar[type[OptionGroup]] = PPOOptions
    clip_coef: float

    @classmethod
    def from_config(cls, config: TrainConfig) -> PPO:
        """See `Algorithm.from_config`."""
        return cls(clip_coef=config.clip_coef, ent_coef=config.ent_coef)

    def policy_loss(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> tuple[torch.Tensor, Metrics]:
        """See `FirstOrderAlgorithm.policy_loss`."""
        ratio = (dist.log_prob(batch.actions) - batch.log_probs).exp()
        clipped = ratio.clamp(1.0 - self.clip_coef, 1.0 + self.clip_coef)
        surrogate_loss = -torch.minimum(ratio * batch.advantages, clipped * batch.advantages).mean()
        entropy = dist.entropy().mean()
        metrics = {
            "policy_loss": surrogate_loss.detach(),
            "entropy": entropy.detach(),
            "clipfrac": ((ratio.detach() - 1.0).abs() > self.clip_coef).float().mean(),
        }
        return surrogate_loss - self.ent_coef * entropy, metrics

    @torch.no_grad()
    def diagnose(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> Metrics:
        """See `FirstOrderAlgorithm.diagnose`."""
        return kl_metrics("raw", dist.kl_parts(batch.old))
