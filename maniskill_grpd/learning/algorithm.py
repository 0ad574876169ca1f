"""What distinguishes one on-policy algorithm from another: the loss of a minibatch.

Rollouts, advantages, the value loss, minibatches and bookkeeping are shared (`update.py`), so that
a comparison of algorithms compares their losses alone. A new algorithm is one file with a class
that has `policy_loss`, and one line in `_ALGORITHMS`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

import torch

from maniskill_grpd.learning.bpp import BPP
from maniskill_grpd.learning.config import TrainConfig
from maniskill_grpd.learning.ppo import PPO
from maniskill_grpd.learning.rollout import Batch


class Algorithm(Protocol):
    """A policy loss."""

    def policy_loss(self, dist: Any, batch: Batch) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
        """Compute the loss of a minibatch.

        Args:
            dist: Action distribution of the current policy for `batch.graph`, differentiable.
            batch: Transitions of the rollout.

        Returns:
            The scalar loss without the value term, and detached scalars to log. Metrics are
            averaged over the minibatches of the last epoch; of those named `*_max` the largest is
            taken.
        """


def make_algorithm(config: TrainConfig) -> Algorithm:
    """Build the algorithm that `config.algorithm` names."""
    return _ALGORITHMS[config.algorithm](config)


def _bpp(config: TrainConfig) -> Algorithm:
    return BPP(
        mean_bound=config.mean_bound,
        cov_bound=config.cov_bound,
        trust_region_coef=config.trust_region_coef,
        ent_coef=config.ent_coef,
    )


def _ppo(config: TrainConfig) -> Algorithm:
    return PPO(clip_coef=config.clip_coef, ent_coef=config.ent_coef)


_ALGORITHMS: dict[str, Callable[[TrainConfig], Algorithm]] = {"bpp": _bpp, "ppo": _ppo}
