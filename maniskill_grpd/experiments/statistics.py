"""Statistics of few runs: interquartile means, bootstrap intervals, probability of improvement, performance profiles.

After Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice". Scores come in strata: one
array of runs (R,) for each task. Resampling draws runs within each task, never across tasks.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence

import numpy as np
from scipy import stats

NUM_RESAMPLES = 2000
"""Bootstrap samples behind an interval."""
CONFIDENCE = 0.95

Interval = tuple[float, float]


def interquartile_mean(scores: np.ndarray, axis: int | None = None) -> np.ndarray:
    """Return the mean of the middle half: a quarter of the scores, rounded down, is cut off at each end.

    Up to three scores nothing is cut and it is the mean.

    Args:
        scores: Any shape.
        axis: The axis to reduce; by default all scores are pooled.

    Raises:
        ValueError: If there are no scores.
    """
    scores = np.asarray(scores, float)
    if scores.size == 0:
        raise ValueError("the interquartile mean needs at least one score")
    return stats.trim_mean(scores, 0.25, axis=axis)


def bootstrap_interval(
    scores: np.ndarray | Sequence[np.ndarray],
    statistic: Callable[..., np.ndarray] = interquartile_mean,
    *,
    generator: np.random.Generator,
    confidence: float = CONFIDENCE,
    num_resamples: int = NUM_RESAMPLES,
) -> Interval:
    """Return a stratified percentile bootstrap interval of a statistic of the pooled scores.

    Args:
        scores: One array (R,) of runs, or one for each task, whose lengths may differ.
        statistic: Maps scores to a number along `axis`.
        generator: Source of the resamples; the same state gives the same interval.
        confidence: Probability that the interval is to cover.
        num_resamples: Number of resamples.

    Returns:
        Low and high end; (nan, nan) if a task has a single run, which says nothing about the spread.

    Raises:
        ValueError: If there are no scores, or `confidence` is not within (0, 1).
    """
    strata = as_strata(scores)

    def pooled(*samples: np.ndarray, axis: int) -> np.ndarray:
        return statistic(np.concatenate(samples, axis=axis), axis=axis)

    return resampled_interval(strata, pooled, generator=generator, confidence=confidence, num_resamples=num_resamples)


def resampled_interval(
    samples: Sequence[np.ndarray],
    statistic: Callable[..., np.ndarray],
    *,
    generator: np.random.Generator,
    confidence: float = CONFIDENCE,
    num_resamples: int = NUM_RESAMPLES,
) -> Interval:
    """Return a percentile bootstrap interval of a statistic of several samples.

    Args:
        samples: Arrays (R,), resampled independently of each other.
        statistic: Called as statistic(*resamples, axis=-1).
        generator: Source of the resamples.
        confidence: Probability that the interval is to cover.
        num_resamples: Number of resamples.

    Returns:
        Low and high end; (nan, nan) if a sample has a single run, or the statistic is not always defined.

    Raises:
        ValueError: If `confidence` is not within (0, 1).
    """
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"confidence must be within (0, 1), got {confidence}")
    if any(len(sample) < 2 for sample in samples):
        return float("nan"), float("nan")
    with np.errstate(divide="ignore", invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)  # the interval is then nan, which says it
        interval = stats.bootstrap(
            tuple(samples),
            statistic,
            n_resamples=num_resamples,
            confidence_level=confidence,
            method="percentile",
            vectorized=True,
            random_state=generator,
        ).confidence_interval
    return float(interval.low), float(interval.high)


def probability_of_improvement(ours: np.ndarray | Sequence[np.ndarray], theirs: np.ndarray | Sequence[np.ndarray]) -> float:
    """Return the probability that a run of ours beats one of theirs, averaged over tasks.

    P(X > Y) + P(X = Y) / 2 over all pairs of runs of a task: the U statistic of Mann and Whitney over the number of pairs.

    Args:
        ours: Scores, one array (R,) or one for each task.
        theirs: Scores on the same tasks in the same order.

    Raises:
        ValueError: If the numbers of tasks differ.
    """
    ours, theirs = as_strata(ours), as_strata(theirs)
    if len(ours) != len(theirs):
        raise ValueError(f"both sides need the same tasks, got {len(ours)} and {len(theirs)}")
    wins = []
    for x, y in zip(ours, theirs, strict=True):
        difference = x[:, None] - y[None, :]
        wins.append(float(((difference > 0) + 0.5 * (difference == 0)).mean()))
    return float(np.mean(wins))


def performance_profile(scores: np.ndarray | Sequence[np.ndarray], thresholds: np.ndarray) -> np.ndarray:
    """Return the share of runs that score more than each threshold (T,), averaged over tasks."""
    shares = [(stratum[:, None] > np.asarray(thresholds)[None, :]).mean(axis=0) for stratum in as_strata(scores)]
    return np.mean(shares, axis=0)


def as_strata(scores: np.ndarray | Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return scores as one float array (R,) for each task.

    Raises:
        ValueError: If a task has no runs, or there are no tasks.
    """
    is_single = np.ndim(scores[0]) == 0 if len(scores) else True
    strata = [np.asarray(stratum, float) for stratum in ([scores] if is_single else scores)]
    if not all(stratum.ndim == 1 and len(stratum) for stratum in strata):
        raise ValueError(f"scores must be arrays (R,) with at least one run, got shapes {[s.shape for s in strata]}")
    return strata
