"""A statement of the paper in a form that data can answer: a measure of two sides, and the bound it is to keep."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from maniskill_grpd.experiments.statistics import (
    CONFIDENCE,
    UNKNOWN,
    Interval,
    contrast,
    deviations,
    effect_size,
    estimate,
    holm,
    interquartile_mean,
    probability_of_improvement,
    ratio_interval,
)

Verdict = Literal["holds", "does not hold", "undecided", "points", "not run"]

MIN_RUNS = 10
"""Runs on each side below which nothing is decided: the number of the paper, at which intervals cover what they say."""


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


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A statement of the paper.

    Attributes:
        text: The statement.
        source: Where it stands.
        paper: The paper's figure, as printed; "-" where it gives none.
        measure: Of means over runs: ours over theirs (ratio), that minus 1 (gain), ours minus theirs (difference); or gain
            in how far runs are from their median (spread).
        metric: Name of the score.
        ours: The side of which something is claimed.
        theirs: The side it is compared with.
        at_least: The claim holds where the measure is not less than this, ...
        at_most: ... and not more than this.

    Ratios are of scores whose mean is positive.
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
        verdict: See `decide`.
        value: The measure, of means over runs; nan if not run.
        interval: Its 95 % interval, not corrected for the number of claims; nan below `MIN_RUNS` runs.
        middle: The same measure of interquartile means, which the paper reports.
        num_runs: Runs per task of the side that has fewer.
        better: Probability that a run of ours scores more than one of theirs.
        effect: Hedges' g, the difference in deviations of a run.
        p_inside: One-sided p value against the measure being out of bounds: small where the claim holds.
        p_outside: Against its being within bounds: small where it does not.
    """

    verdict: Verdict
    value: float = math.nan
    interval: Interval = UNKNOWN
    middle: float = math.nan
    num_runs: int = 0
    better: float = math.nan
    effect: float = math.nan
    p_inside: float = math.nan
    p_outside: float = math.nan

    @property
    def p_value(self) -> float:
        """Two-sided p value of the claim."""
        return min(2.0 * min(self.p_inside, self.p_outside), 1.0)


NOT_RUN = Finding("not run")


def examine(claim: Claim, ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Finding:
    """Measure what a claim is about.

    Args:
        claim: The claim.
        ours: Scores of one side, one array (R,) of runs for each task; in the order of those of `theirs` if the claim is paired.
        theirs: Scores of the other side on the same tasks.

    Returns:
        The finding, undecided as yet, or "points" with fewer than `MIN_RUNS` runs.
    """
    if claim.measure == "spread":
        ours, theirs = ([deviations(runs) for runs in side] for side in (ours, theirs))
    num_runs = min(len(runs) for runs in (*ours, *theirs))
    is_enough = num_runs >= MIN_RUNS
    p_inside, p_outside = _p_values(claim, ours, theirs) if is_enough else (math.nan, math.nan)
    return Finding(
        verdict="undecided" if is_enough else "points",
        value=_measure(claim, estimate(ours).value, estimate(theirs).value),
        interval=_interval(claim, ours, theirs) if is_enough else UNKNOWN,
        middle=_measure(claim, _middle(ours), _middle(theirs)),
        num_runs=num_runs,
        better=probability_of_improvement(ours, theirs),
        effect=effect_size(ours, theirs, is_paired=claim.is_paired),
        p_inside=p_inside,
        p_outside=p_outside,
    )


def decide(findings: Sequence[Finding]) -> list[Finding]:
    """Decide the claims of a study together.

    A claim holds, or does not, where its p value is at most 5 % after Holm's correction for all claims of the study that have
    runs enough: the probability that any of them is decided wrongly is then at most 5 %. A claim that is not decided so remains
    undecided, one with fewer than `MIN_RUNS` runs is told as points.
    """
    open_ones = [finding for finding in findings if finding.verdict == "undecided" and not math.isnan(finding.p_value)]
    corrected = dict(zip(map(id, open_ones), holm([finding.p_value for finding in open_ones]), strict=True))
    return [_decide(finding, corrected.get(id(finding), 1.0)) for finding in findings]


def _decide(finding: Finding, corrected: float) -> Finding:
    if finding.verdict != "undecided" or corrected > 1.0 - CONFIDENCE:
        return finding
    return dataclasses.replace(finding, verdict="holds" if finding.p_inside < finding.p_outside else "does not hold")


def _middle(strata: Sequence[np.ndarray]) -> float:
    return float(np.mean([interquartile_mean(runs) for runs in strata]))


def _measure(claim: Claim, first: float, second: float) -> float:
    if claim.measure == "difference":
        return first - second
    ratio = first / second if second else math.nan
    return ratio if claim.measure == "ratio" else ratio - 1.0


def _interval(claim: Claim, ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> Interval:
    if claim.measure == "difference":
        return contrast(ours, theirs, 1.0, is_paired=claim.is_paired).interval()
    low, high = ratio_interval(ours, theirs, is_paired=claim.is_paired)
    return (low, high) if claim.measure == "ratio" else (low - 1.0, high - 1.0)


def _p_values(claim: Claim, ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the p values against being outside and against being inside of the bounds."""
    inside, outside = [], []
    for bound, is_lower in ((claim.at_least, True), (claim.at_most, False)):
        if math.isfinite(bound):
            above, below = _sides_of(claim, ours, theirs, bound)
            inside.append(above if is_lower else below)
            outside.append(below if is_lower else above)
    return max(inside), min(outside)


def _sides_of(claim: Claim, ours: Sequence[np.ndarray], theirs: Sequence[np.ndarray], bound: float) -> tuple[float, float]:
    """Return p values that are small where the measure is above a bound, and where it is below."""
    # A ratio lies above a bound where ours minus so many times theirs is positive.
    factor, rest = {"difference": (1.0, bound), "ratio": (bound, 0.0)}.get(claim.measure, (1.0 + bound, 0.0))
    found = contrast(ours, theirs, factor, is_paired=claim.is_paired)
    mirrored = dataclasses.replace(found, value=-found.value)
    return found.p_above(rest), mirrored.p_above(-rest)
