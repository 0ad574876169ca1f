"""Claims and what data say about them."""

import dataclasses

import numpy as np
import pytest
from synthetic_results import STUDY

from maniskill_grpd.experiments.claim import Claim, Side, judge

GAIN = Claim(text="", source="", paper="", measure="gain", metric="return", ours=Side("a"), theirs=Side("b"), at_least=0.0)


def find(claim, ours, theirs):
    return judge(
        claim, [np.array(runs, float) for runs in ours], [np.array(runs, float) for runs in theirs], np.random.default_rng(0)
    )


def test_gain_is_the_ratio_of_interquartile_means_less_one():
    # theirs without its extremes: (2 + 4) / 2 = 3; ours (6 + 6) / 2 = 6
    finding = find(GAIN, [[0, 6, 6, 100]], [[0, 2, 4, 100]])
    assert finding.value == 1.0
    assert finding.num_runs == 4


@pytest.mark.parametrize(
    ("measure", "expected"), [("ratio", 1.5), ("gain", 0.5), ("difference", 1.0), ("spread", 8.0 / 2.0 - 1.0)]
)
def test_measures(measure, expected):
    # means 3 and 2; variances of (1, 5) and (1, 3): 8 and 2
    claim = dataclasses.replace(GAIN, measure=measure)
    assert find(claim, [[1, 5]], [[1, 3]]).value == pytest.approx(expected)


@pytest.mark.parametrize(
    ("ours", "verdict"),
    [([10, 11, 12], "holds"), ([1, 2, 3], "does not hold"), ([4, 6, 9], "undecided"), ([10, 11], "undecided")],
)
def test_a_claim_is_decided_where_the_interval_is_on_one_side(ours, verdict):
    assert find(GAIN, [ours], [[5, 6, 7]]).verdict == verdict


def test_an_upper_bound_is_held_to():
    claim = dataclasses.replace(GAIN, measure="ratio", at_least=-np.inf, at_most=0.6)
    assert find(claim, [[5, 5.5, 5.2]], [[10, 10, 10]]).verdict == "holds"
    assert find(claim, [[9, 9.5, 9.2]], [[10, 10, 10]]).verdict == "does not hold"


def test_nothing_divided_by_nothing_is_undecided():
    finding = find(GAIN, [[0, 0, 0]], [[0, 0, 0]])
    assert finding.verdict == "undecided"
    assert GAIN.format(finding.value) == "undefined"


def test_paired_runs_stay_together():
    # Runs differ by far more than conditions do; half is lost in every run, so that there is no doubt about the ratio.
    claim = dataclasses.replace(GAIN, measure="ratio", ours=Side("a", None, ("noise",)), theirs=Side("a"))
    before = np.array([2.0, 40.0, 600.0])
    paired = find(claim, [before / 2], [before])
    assert paired.interval == pytest.approx((0.5, 0.5))
    unpaired = find(dataclasses.replace(claim, theirs=Side("b")), [before / 2], [before])
    assert unpaired.interval[1] - unpaired.interval[0] > 1.0


def test_tasks_are_pooled_and_resampled_apart():
    # Within a task runs are equal, so the pooled mean is certain: (1 + 3) / 2 against (1 + 1) / 2.
    finding = find(GAIN, [[1, 1, 1], [3, 3, 3]], [[1, 1, 1], [1, 1, 1]])
    assert finding.value == pytest.approx(1.0)
    assert finding.interval == pytest.approx((1.0, 1.0))
    assert finding.better == 0.75  # ties on one task, wins on the other


@pytest.mark.parametrize(
    ("measure", "value", "text"),
    [("gain", 0.184, "+18 %"), ("difference", -0.19, "-19 points"), ("ratio", 1.2, "1.20x"), ("spread", -0.37, "-37 %")],
)
def test_figures_are_written_like_the_papers(measure, value, text):
    assert dataclasses.replace(GAIN, measure=measure).format(value) == text


def test_pairing_follows_from_the_sides():
    assert [claim.is_paired for claim in STUDY.claims] == [False, True, False]
