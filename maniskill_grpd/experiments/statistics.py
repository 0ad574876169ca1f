"""Statistics of few runs: t intervals of means and of comparisons, Holm's correction, effect sizes, probability of improvement.

Scores come in strata: one array of runs (R,) for each task. Every task counts alike, however many runs it has. A seed of a hard
task learns it or does not, so that scores are often in two heaps: means of ten runs and their t intervals still cover then, where
trimmed means, whose middle half may be all of one heap, do not (`tests/experiments/test_coverage.py` has the numbers).

After Agarwal et al. 2021, "Deep reinforcement learning at the edge of the statistical precipice", where the paper's interquartile
means come from; Welch 1947 for the degrees of freedom, Fieller 1954 for ratios, Brown and Forsythe 1974 for spreads.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

CONFIDENCE = 0.95

Interval = tuple[float, float]
Strata = Sequence[np.ndarray]

UNKNOWN: Interval = (math.nan, math.nan)


@dataclass(frozen=True)
class Estimate:
    """A mean as far as its runs tell it.

    Attributes:
        value: The mean.
        error: Its standard error; nan for a single run.
        degrees: Degrees of freedom of that error.
    """

    value: float
    error: float
    degrees: float

    def interval(self, confidence: float = CONFIDENCE) -> Interval:
        """Return the t interval; (nan, nan) for a single run, which says nothing about the spread.

        Raises:
            ValueError: If `confidence` is not within (0, 1).
        """
        if not 0.0 < confidence < 1.0:
            raise ValueError(f"confidence must be within (0, 1), got {confidence}")
        reach = self.error * _quantile(self.degrees, confidence)
        return self.value - reach, self.value + reach

    def p_above(self, bound: float = 0.0) -> float:
        """Return the one-sided p value against the mean being at most a bound: small where it lies above."""
        if math.isnan(self.error):
            return math.nan
        if self.error == 0.0:
            return 0.0 if self.value > bound else 1.0
        return float(stats.t.sf((self.value - bound) / self.error, self.degrees))


def estimate(scores: np.ndarray | Strata) -> Estimate:
    """Estimate the mean over tasks of the mean over runs.

    Args:
        scores: One array (R,) of runs, or one for each task, whose lengths may differ.

    Raises:
        ValueError: If there are no scores.
    """
    strata = as_strata(scores)
    means = [float(stratum.mean()) for stratum in strata]
    # Squared errors of the means, whose degrees of freedom add up as Welch and Satterthwaite have it.
    squares = [float(stratum.var(ddof=1)) / len(stratum) if len(stratum) > 1 else math.nan for stratum in strata]
    total = sum(squares)
    weights = [square**2 / (len(stratum) - 1) for square, stratum in zip(squares, strata, strict=True) if len(stratum) > 1]
    degrees = total**2 / sum(weights) if total > 0.0 and sum(weights) > 0.0 else 1.0
    return Estimate(sum(means) / len(means), math.sqrt(total) / len(means), degrees)


def contrast(ours: Strata, theirs: Strata, factor: float, *, is_paired: bool) -> Estimate:
    """Estimate the mean of ours minus `factor` times that of theirs.

    Args:
        ours: Scores, one array (R,) for each task.
        theirs: The same of the other side; its runs are those of ours, in the same order, if they are paired.
        factor: What theirs count.
        is_paired: Whether both sides are the same runs.
    """
    ours, theirs = as_strata(ours), as_strata(theirs)
    if is_paired:
        return estimate([x - factor * y for x, y in zip(ours, theirs, strict=True)])
    first, second = estimate(ours), estimate(theirs)
    squares = first.error**2, (factor * second.error) ** 2
    total = sum(squares)
    # Of the sum of two variances each of which has its own degrees of freedom.
    spread = squares[0] ** 2 / first.degrees + squares[1] ** 2 / second.degrees
    degrees = total**2 / spread if spread > 0.0 else 1.0
    return Estimate(first.value - factor * second.value, math.sqrt(total), degrees)


def ratio_interval(ours: Strata, theirs: Strata, *, is_paired: bool, confidence: float = CONFIDENCE) -> Interval:
    """Return Fieller's interval of mean over mean: the factors of which the contrast may be zero.

    Returns:
        Low and high end; (nan, nan) where the mean of theirs may be zero itself, so that no ratio is excluded.
    """

    def excess(factor: float) -> float:
        found = contrast(ours, theirs, factor, is_paired=is_paired)
        return abs(found.value) - found.error * _quantile(found.degrees, confidence)

    below = estimate(theirs)
    if math.isnan(below.error) or abs(below.value) <= below.error * _quantile(below.degrees, confidence):
        return UNKNOWN
    middle = estimate(ours).value / below.value
    return _edge(excess, middle, -1.0), _edge(excess, middle, 1.0)


def _edge(excess: Callable[[float], float], start: float, direction: float) -> float:
    """Return where, on one side of a place inside, the function comes to be positive."""
    if excess(start) >= 0.0:  # no spread at all
        return start
    step = 1e-3 * direction * max(1.0, abs(start))
    while excess(start + step) < 0.0:
        step *= 2.0
        if abs(step) > 1e6 * max(1.0, abs(start)):
            return math.copysign(math.inf, direction)
    return float(optimize.brentq(excess, start + step / 2.0 if excess(start + step / 2.0) < 0.0 else start, start + step))


def deviations(scores: np.ndarray) -> np.ndarray:
    """Return how far each run (R,) is from the median: their means compare spreads (Brown and Forsythe 1974)."""
    return np.abs(scores - np.median(scores))


def effect_size(ours: Strata, theirs: Strata, *, is_paired: bool) -> float:
    """Return Hedges' g, the difference of means in deviations of a run, averaged over tasks; nan without a spread.

    Deviations are those of both sides together, of paired runs those of their differences.
    """
    found = [
        _paired_effect(x - y) if is_paired else _effect(x, y) for x, y in zip(as_strata(ours), as_strata(theirs), strict=True)
    ]
    return float(np.mean(found))


def _effect(x: np.ndarray, y: np.ndarray) -> float:
    degrees = len(x) + len(y) - 2
    squares = float(((x - x.mean()) ** 2).sum() + ((y - y.mean()) ** 2).sum())
    return _unbiased(float(x.mean() - y.mean()), squares, degrees)


def _paired_effect(difference: np.ndarray) -> float:
    squares = float(((difference - difference.mean()) ** 2).sum())
    return _unbiased(float(difference.mean()), squares, len(difference) - 1)


def _unbiased(difference: float, squares: float, degrees: int) -> float:
    if degrees < 1 or squares <= 0.0:
        return math.nan
    return (1.0 - 3.0 / (4.0 * degrees - 1.0)) * difference / math.sqrt(squares / degrees)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p values corrected for being n (Holm 1979): n times the smallest, n - 1 times the next, and so on."""
    order = np.argsort(p_values)
    corrected = [math.nan] * len(p_values)
    largest = 0.0
    for rank, place in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[place]))
        corrected[place] = largest
    return corrected


def interquartile_mean(scores: np.ndarray) -> float:
    """Return the mean of the middle half: a quarter of the scores, rounded down, is cut off at each end.

    Up to three scores nothing is cut and it is the mean. Scores of any shape are pooled.

    Raises:
        ValueError: If there are no scores.
    """
    scores = np.asarray(scores, float)
    if scores.size == 0:
        raise ValueError("the interquartile mean needs at least one score")
    return float(stats.trim_mean(scores, 0.25, axis=None))


def probability_of_improvement(ours: np.ndarray | Strata, theirs: np.ndarray | Strata) -> float:
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


def performance_profile(scores: np.ndarray | Strata, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of runs that score more than each threshold (T,), averaged over tasks."""
    shares = [(stratum[:, None] > np.asarray(thresholds)[None, :]).mean(axis=0) for stratum in as_strata(scores)]
    return np.mean(shares, axis=0)


def as_strata(scores: np.ndarray | Strata) -> list[np.ndarray]:
    """Return scores as one float array (R,) for each task.

    Raises:
        ValueError: If a task has no runs, or there are no tasks.
    """
    is_single = np.ndim(scores[0]) == 0 if len(scores) else True
    strata = [np.asarray(stratum, float) for stratum in ([scores] if is_single else scores)]
    if not all(stratum.ndim == 1 and len(stratum) for stratum in strata):
        raise ValueError(f"scores must be arrays (R,) with at least one run, got shapes {[s.shape for s in strata]}")
    return strata


def _quantile(degrees: float, confidence: float) -> float:
    return float(stats.t.ppf(0.5 + confidence / 2.0, degrees))
