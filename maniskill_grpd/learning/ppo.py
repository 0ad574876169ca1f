"""Proximal Policy Optimisation with a clipped surrogate, the baseline of BPP."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import torch

from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.learning.rollout import Batch, Rollout
from maniskill_grpd.learning.trust_region import kl_metrics
from maniskill_grpd.learning.update import FirstOrderAlgorithm, Learner, Metrics
from maniskill_grpd.policies import ActionDistribution

if TYPE_CHECKING:
    from maniskill_grpd.learning.config import TrainConfig


_LARGEST_CHANGE = 1.5
"""Factor by which an update changes an adapted clipping at most."""
_RANGE = (0.01, 5.0)
"""Of an adapted clipping."""
_TINY = 1e-12


@dataclass(frozen=True, kw_only=True)
class PPOOptions(OptionGroup):
    """Options of PPO."""

    RANGES: ClassVar[Mapping[str, str]] = {"clip_coef": "(0, inf)", "clip_kl": "(0, inf)"}

    clip_coef: float = 0.2
    """ppo: clipping of the probability ratio"""
    clip_kl: float | None = None
    """ppo: mean KL of an update [nats] that clip_coef is adapted to after each, from its value here; by default it stays"""

    def contradictions(self) -> dict[str, bool]:
        """See `OptionGroup.contradictions`. The config that inherits this has `algorithm`."""
        return {
            **super().contradictions(),
            f"--clip_kl belongs to --algorithm ppo, not to {self.algorithm}": (
                self.clip_kl is not None and self.algorithm != "ppo"
            ),
        }


@dataclass(kw_only=True)
class PPO(FirstOrderAlgorithm):
    """Maximise the clipped surrogate (Schulman et al. 2017, eq. 7).

    loss = -E[ min(ratio A, clip(ratio, 1 - clip_coef, 1 + clip_coef) A) ] - ent_coef E[ H(pi) ]

    With `clip_kl` the clipping follows the size of the steps it allows, so that they can be made as large as those of a trust
    region: clip_coef <- clip_coef clip(sqrt(clip_kl / KL), 1 / 1.5, 1.5) after each update, with the mean KL of its last epoch,
    which grows about as its square.
    """

    Options: ClassVar[type[OptionGroup]] = PPOOptions
    clip_coef: float
    clip_kl: float | None = None

    @classmethod
    def from_config(cls, config: TrainConfig) -> PPO:
        """See `Algorithm.from_config`."""
        return cls(clip_coef=config.clip_coef, clip_kl=config.clip_kl, ent_coef=config.ent_coef)

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

    def update(self, learner: Learner, rollout: Rollout) -> dict[str, float]:
        """Update the policy, then the clipping; see `Algorithm.update`."""
        metrics = super().update(learner, rollout)
        metrics["clip_coef"] = self.clip_coef
        if self.clip_kl is not None:
            self.adapt(metrics["kl_raw"])
        return metrics

    def adapt(self, kl: float) -> None:
        """Change the clipping after an update of a mean KL [nats]."""
        wanted = math.sqrt(self.clip_kl / max(kl, _TINY))
        self.clip_coef = min(max(self.clip_coef * min(max(wanted, 1.0 / _LARGEST_CHANGE), _LARGEST_CHANGE), _RANGE[0]), _RANGE[1])

    def state_dict(self) -> dict[str, Any]:
        """See `Algorithm.state_dict`; a clipping that stays is an option, not a state."""
        return {} if self.clip_kl is None else {"clip_coef": self.clip_coef}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """See `Algorithm.load_state_dict`."""
        if self.clip_kl is None:
            super().load_state_dict(state)
        else:
            self.clip_coef = float(state["clip_coef"])

    @torch.no_grad()
    def diagnose(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> Metrics:
        """See `FirstOrderAlgorithm.diagnose`."""
        return kl_metrics("raw", dist.kl_parts(batch.old))
