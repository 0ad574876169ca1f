"""What distinguishes one on-policy algorithm from another: how it uses a rollout.

Rollouts, advantages, the value loss, minibatches and bookkeeping are shared (`update.py`), so that
a comparison of algorithms compares their losses alone. A new algorithm is one file with a subclass
of `update.FirstOrderAlgorithm` (a loss) or `update.Algorithm` (a step of its own), and one line in
a table here.
"""

from __future__ import annotations

from collections.abc import Callable

from maniskill_grpd.learning.bpp import BPP
from maniskill_grpd.learning.config import TrainConfig
from maniskill_grpd.learning.fisher import FisherBPP
from maniskill_grpd.learning.lagrangian import LagrangianBPP
from maniskill_grpd.learning.ppo import PPO
from maniskill_grpd.learning.trust_region import Bounds
from maniskill_grpd.learning.update import Algorithm


def make_algorithm(config: TrainConfig) -> Algorithm:
    """Build the algorithm that `config.algorithm` and, for bpp, `config.trust_region` name."""
    if config.algorithm == "bpp":
        return _TRUST_REGIONS[config.trust_region](config)
    return PPO(clip_coef=config.clip_coef, ent_coef=config.ent_coef)


def _bounds(config: TrainConfig) -> Bounds:
    return Bounds(mean=config.mean_bound, cov=config.cov_bound, gripper=config.gripper_bound)


def _projection(config: TrainConfig) -> BPP:
    return BPP(
        bounds=_bounds(config),
        trust_region_coef=config.trust_region_coef,
        ent_coef=config.ent_coef,
        entropy_floor=config.entropy_floor,
    )


def _lagrangian(config: TrainConfig) -> LagrangianBPP:
    return LagrangianBPP(
        bounds=_bounds(config), dual_step=config.dual_step, max_multiplier=config.max_multiplier, ent_coef=config.ent_coef
    )


def _fisher(config: TrainConfig) -> FisherBPP:
    return FisherBPP(
        bounds=_bounds(config), num_samples=config.fisher_samples, damping=config.fisher_damping, ent_coef=config.ent_coef
    )


_TRUST_REGIONS: dict[str, Callable[[TrainConfig], Algorithm]] = {
    "projection": _projection,
    "lagrangian": _lagrangian,
    "fisher": _fisher,
}
