"""Seeds of the episodes of a training: those it learns from, and those of its evaluations."""

from __future__ import annotations

import numpy as np

from maniskill_grpd.learning.config import TrainConfig

FIRST_TRAINING_SEED = 2**30
"""Environments are trained on seeds from here up, so that no seed below is ever trained on."""

FIRST_EVAL_SEED = 500_000
"""Evaluations during training, which choose best_ckpt.pt, use the seeds from here on."""


def episode_seeds(config: TrainConfig, iteration: int) -> list[int]:
    """Return the seeds the environments are reset with at the start of an iteration.

    Independent for different (seed, iteration), and in [2^30, 2^31): disjoint from evaluation seeds.
    """
    state = np.random.SeedSequence([config.seed, iteration]).generate_state(config.num_envs)
    return (FIRST_TRAINING_SEED + state % FIRST_TRAINING_SEED).tolist()
