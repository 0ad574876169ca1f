"""Bounded Policy Projection: a policy gradient through a KL trust-region projection (section II.E)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import torch

from maniskill_grpd.learning.bernoulli_projection import project_bernoulli
from maniskill_grpd.learning.entropy_floor import raise_entropy
from maniskill_grpd.learning.fisher import FisherBPP, FisherOptions
from maniskill_grpd.learning.lagrangian import LagrangianBPP, LagrangianOptions
from maniskill_grpd.learning.options import OptionGroup
from maniskill_grpd.learning.path_projection import project_along_path
from maniskill_grpd.learning.projection import project_joint, project_unchecked
from maniskill_grpd.learning.rollout import Batch
from maniskill_grpd.learning.schedule import Coefficients
from maniskill_grpd.learning.trust_region import Bounds, activity_metrics, kl_metrics
from maniskill_grpd.learning.update import Algorithm, FirstOrderAlgorithm, Metrics
from maniskill_grpd.policies import ActionDistribution

if TYPE_CHECKING:
    from maniskill_grpd.learning.config import TrainConfig


@dataclass(frozen=True, kw_only=True)
class BPPOptions(LagrangianOptions, FisherOptions):
    """Options of BPP, whichever way it keeps its trust region."""

    RANGES: ClassVar[Mapping[str, str]] = {
        "trust_region_coef": "[0, inf)",
        "entropy_floor": "(-inf, inf)",
        "entropy_floor_final": "(-inf, inf)",
    }

    trust_region: Literal["projection", "lagrangian", "fisher"] = "projection"
    """bpp: projection (differentiable), lagrangian (dual ascent) or fisher (natural gradient with line search)"""
    trust_region_coef: float = 10.0
    """projection: weight of the loss that draws the policy to its projection"""
    entropy_floor: float | None = None
    """projection: smallest entropy of an actuator's Gaussian [nats]; 2.2 at the initial deviation of 0.5, -1 at 0.17"""
    entropy_floor_final: float | None = None
    """projection: where the floor has come linearly by the end; by default it stays"""

    def contradictions(self) -> dict[str, bool]:
        """See `OptionGroup.contradictions`. The config that inherits this has `algorithm`, `target_kl` and `compile`."""
        is_bpp = self.algorithm == "bpp"
        is_fisher = is_bpp and self.trust_region == "fisher"
        return {
            **super().contradictions(),
            f"--trust_region {self.trust_region} belongs to --algorithm bpp, not to {self.algorithm}": (
                not is_bpp and self.trust_region != "projection"
            ),
            "--entropy_floor works with --algorithm bpp --trust_region projection only": (
                self.entropy_floor is not None and not (is_bpp and self.trust_region == "projection")
            ),
            "--entropy_floor_final needs --entropy_floor, where it starts from": (
                self.entropy_floor_final is not None and self.entropy_floor is None
            ),
            "--target_kl ends minibatch updates early; --trust_region fisher has a line search": (
                self.target_kl is not None and is_fisher
            ),
            "--compile has no second derivatives, which --trust_region fisher needs; drop one": self.compile and is_fisher,
        }


@dataclass(kw_only=True)
class BPP(FirstOrderAlgorithm):
    """Maximise the surrogate (eq. 9, 65) of the projected policy: `--trust_region projection`.

        loss = -E[ pi_p(a|s) / pi_old(a|s) A ] + trust_region_coef E[ KL(pi || stopgrad(pi_p)) ]
               - ent_coef E[ H(pi_p) ]

    pi_p is pi projected onto the region (`projection.project_joint`, actuator by actuator
    `projection.project_gaussian`, and `bernoulli_projection.project_bernoulli` for grippers), so eq.
    10 and 60 hold at every state for the policy that is optimised. What acts in the next rollout is pi
    itself; the second term draws it back to pi_p, and is the only gradient where the projection is
    active along a clamped direction. `acting_policy.confine` then makes eq. 64 hold for pi.

    With an entropy floor, standard deviations are raised to it before the projection, so that the
    KL bounds go first where both cannot be kept.

    Limitations: for pi itself the bound holds on average over states; `kl_acting_p99` shows the tail.
    """

    Options: ClassVar[type[OptionGroup]] = BPPOptions
    bounds: Bounds
    trust_region_coef: float
    entropy_floor: float | None = None

    @classmethod
    def from_config(cls, config: TrainConfig) -> Algorithm:
        """Return this way, or the other one that `config.trust_region` names; see `Algorithm.from_config`."""
        if config.trust_region == "lagrangian":
            return LagrangianBPP.from_config(config)
        if config.trust_region == "fisher":
            return FisherBPP.from_config(config)
        return cls(
            bounds=config.bounds,
            trust_region_coef=config.trust_region_coef,
            ent_coef=config.ent_coef,
            entropy_floor=config.entropy_floor,
        )

    def acting_bound(self, old: ActionDistribution) -> tuple[float, bool]:
        """See `Algorithm.acting_bound`."""
        return self.bounds.acting(old), self.bounds.per_actuator

    def adopt(self, coefficients: Coefficients) -> None:
        """See `Algorithm.adopt`."""
        super().adopt(coefficients)
        self.entropy_floor = coefficients.entropy_floor

    def policy_loss(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> tuple[torch.Tensor, Metrics]:
        """See `FirstOrderAlgorithm.policy_loss`."""
        log_ratio = projected.log_prob(batch.actions) - batch.log_probs
        surrogate_loss = -(log_ratio.exp() * batch.advantages).mean()
        trust_region_loss = dist.kl_parts(projected.detach()).total.mean()
        entropy = projected.entropy().mean()
        loss = surrogate_loss + self.trust_region_coef * trust_region_loss - self.ent_coef * entropy
        metrics = {
            "policy_loss": surrogate_loss.detach(),
            "trust_region_loss": trust_region_loss.detach(),
            "entropy": entropy.detach(),
        }
        return loss, metrics

    def project(self, dist: ActionDistribution, old: ActionDistribution) -> ActionDistribution:
        """Return the nearest policy within the bounds, differentiable in `dist`."""
        std = dist.std
        if self.entropy_floor is not None:
            std = raise_entropy(std, self.entropy_floor, dist.mean.shape[-1])
        limits = {"mean_bound": self.bounds.mean, "cov_bound": self.bounds.cov}
        gripper_bound: float | torch.Tensor = self.bounds.gripper
        if dist.spread is not None:
            mean, std = project_along_path(dataclasses.replace(dist, std=std), old, self.bounds)
        elif self.bounds.per_actuator:
            mean, std = project_unchecked(dist.mean, std, old.mean, old.std, **limits)
        else:
            mean, std = project_joint(dist.mean, std, old.mean, old.std, dist.mask, **limits)
        logits = dist.gripper_logits
        if not self.bounds.per_actuator:
            # Equal shares keep the sum within the bound; the nearest variables might share it in another way.
            gripper_bound = gripper_bound / dist.mask.sum(-1, keepdim=True).clamp(min=1)
        if logits is not None:
            logits = project_bernoulli(logits, old.gripper_logits, bound=gripper_bound)
        return dataclasses.replace(dist, mean=mean, std=std, gripper_logits=logits)

    @torch.no_grad()
    def diagnose(self, dist: ActionDistribution, projected: ActionDistribution, batch: Batch) -> Metrics:
        """See `FirstOrderAlgorithm.diagnose`: KLs before and after projection, bound activity."""
        raw = dist.kl_parts(batch.old)
        return {
            **kl_metrics("raw", raw),
            **kl_metrics("projected", projected.kl_parts(batch.old)),
            **activity_metrics(dist, raw, self.bounds),
        }
