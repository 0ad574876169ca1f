"""Learning curves of several runs, and what they say about sample efficiency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from maniskill_grpd.experiments.statistics import estimate


@dataclass(frozen=True)
class Curve:
    """A score over the steps of one run.

    Attributes:
        steps: Environment steps, increasing, (P,).
        scores: (P,).
    """

    steps: np.ndarray
    scores: np.ndarray

    def __post_init__(self) -> None:
        if len(self.steps) != len(self.scores) or not len(self.steps):
            raise ValueError(f"a curve needs as many steps as scores, got {len(self.steps)} and {len(self.scores)}")
        if np.any(np.diff(self.steps) <= 0):
            raise ValueError("the steps of a curve must increase")


@dataclass(frozen=True)
class Band:
    """Mean over runs, with its t interval, at common steps; arrays (P,)."""

    steps: np.ndarray
    middle: np.ndarray
    low: np.ndarray
    high: np.ndarray


def efficiency_band(curves: Sequence[Curve]) -> Band:
    """Summarise the curves of several runs where all of them have been measured.

    Args:
        curves: One for each run.

    Returns:
        The band at the steps of the shortest curve; scores of the others are interpolated linearly. Without a second run the
        interval is nan.
    """
    steps = min((curve.steps for curve in curves), key=lambda steps: steps[-1])
    scores = np.stack([np.interp(steps, curve.steps, curve.scores) for curve in curves])
    low, high = np.array([estimate(column).interval() for column in scores.T]).T
    return Band(steps, scores.mean(axis=0), low, high)


def mean_over_training(curve: Curve) -> float:
    """Return the mean score over the steps from the first to the last: the higher, the earlier it was learned."""
    if len(curve.steps) == 1:
        return float(curve.scores[0])
    areas = np.diff(curve.steps) * (curve.scores[1:] + curve.scores[:-1]) / 2
    return float(areas.sum() / (curve.steps[-1] - curve.steps[0]))
