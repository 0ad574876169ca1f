"""A statement of the paper in a form that data can answer: a measure of two sides, and the bound it is to keep."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from maniskill_grpd.experiments.statistics import Interval, interquartile_mean, probability_of_improvement, resampled_interval

Verdict = Literal["holds", "does not hold", "undecided", "not run"]

MIN_RUNS = 3
"""Runs on each side below which nothing is decided."""


@dataclass(frozen=True)
class Side:
    """One side of a comparison.

    Attributes:
        arm: Name of an arm of the study.
        task: Name of a task of the study; None: all of them.
        conditions: Names of conditions, over which the scores of a run are averaged; none: the first of the task.
    """

    arm: str
    task: str | None = None
    conditions: tuple[str, ...] = ()


def _ratio(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    return interquartile_mean(ours, axis=-1) / interquartile_mean(theirs, axis=-1)


def _gain(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    return _ratio(ours, theirs) - 1.0


def _difference(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    return interquartile_mean(ours, axis=-1) - interquartile_mean(theirs, axis=-1)


def _spread(ours: np.ndarray, theirs: np.ndarray) -> np.ndarray:
    return ours.var(axis=-1, ddof=1) / theirs.var(axis=-1, ddof=1) - 1.0


MEASURES: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "ratio": _ratio,
    "gain": _gain,
    "difference": _difference,
    "spread": _spread,
}
"""Of scores (..., runs) of ours and theirs: IQM over IQM; that minus 1; IQM minus IQM; variance over variance, minus 1."""


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper.

    Attributes:
        text: The statement.
        source: Where it stands.
        paper: The paper's figure, as printed; "-" where it gives none.
        measure: A key of `MEASURES`.
        metric: Name of the score.
        ours: The side of which something is claimed.
        theirs: The side it is compared with.
        at_least: The claim holds where the measure is not less than this, ...
        at_most: ... and not more than this.
    """

    text: str
    source: str
    paper: str
    measure: Literal["ratio", "gain", "difference", "spread"]
    metric: str
    ours: Side
    theirs: Side
    at_least: float = -np.inf
    at_most: float = np.inf

    @property
    def is_paired(self) -> bool:
        """Whether both sides are the same runs under different conditions."""
        return (self.ours.arm, self.ours.task) == (self.theirs.arm, self.theirs.task)

    def format(self, value: float) -> str:
        """Return a value of the measure as people read it; "undefined" where nothing was divided by nothing."""
        if not np.isfinite(value):
            return "undefined"
        if self.measure == "ratio":
            return f"{value:.2f}x"
        unit = " points" if self.measure == "difference" else " %"
        return f"{100 * value:+,.0f}{unit}"


@dataclass(frozen=True)
class Finding:
    """What the data say about a claim.

    Attributes:
        verdict: "holds" or "does not hold" where the whole interval of the measure is on one side of the bound.
        value: The measure; nan if not run.
        interval: Its 95 % bootstrap interval, runs resampled within each task.
        num_runs: Runs per task of the side that has fewer.
        better: Probability that a run of ours scores more than one of theirs.
    """

    verdict: Verdict
    value: float = np.nan
    interval: Interval = (np.nan, np.nan)
    num_runs: int = 0
    better: float = np.nan


def judge(claim: Claim, ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], generator: np.random.Generator) -> Finding:
    """Compare a claim with data.

    Args:
        claim: The claim.
        ours: Scores of one side, one array (R,) of runs for each task; in the order of those of `theirs` if the claim is paired.
        theirs: Scores of the other side on the same tasks.
        generator: Source of the bootstrap.

    Returns:
        The finding. With fewer than `MIN_RUNS` runs, or where the measure is undefined, it is undecided.
    """
    measure = MEASURES[claim.measure]
    # What is resampled are places in the lists of runs, so that paired runs stay together.
    places = [np.arange(len(runs)) for runs in ours]
    places += [] if claim.is_paired else [np.arange(len(runs)) for runs in theirs]

    def statistic(*drawn: np.ndarray, axis: int = -1) -> np.ndarray:
        chosen = [
            np.concatenate([runs[i] for runs, i in zip(side, places_of, strict=True)], axis)
            for side, places_of in ((ours, drawn[: len(ours)]), (theirs, drawn[-len(theirs) :]))
        ]
        return measure(*chosen)

    num_runs = min(len(runs) for runs in (*ours, *theirs))
    with np.errstate(divide="ignore", invalid="ignore"):
        value = float(statistic(*places)) if num_runs > 1 or claim.measure != "spread" else np.nan
    interval = resampled_interval(places, statistic, generator=generator)
    return Finding(
        _verdict(claim, value, interval, num_runs), value, interval, num_runs, probability_of_improvement(ours, theirs)
    )


def _verdict(claim: Claim, value: float, interval: Interval, num_runs: int) -> Verdict:
    low, high = interval
    if num_runs < MIN_RUNS or not np.isfinite([value, low, high]).all():
        return "undecided"
    if claim.at_least <= low and high <= claim.at_most:
        return "holds"
    return "does not hold" if high < claim.at_least or low > claim.at_most else "undecided"
