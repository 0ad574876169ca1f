"""Claims and what data say about them."""

import dataclasses

import numpy as np
import pytest
from synthetic_results import STUDY

from maniskill_grpd.experiments.claim import Claim, Side, decide, examine

GAIN = Claim(text="", source="", paper="", measure="gain", metric="return", ours=Side("a"), theirs=Side("b"), at_least=0.0)


def find(claim, ours, theirs):
    (found,) = decide([examine(claim, [np.array(runs, float) for runs in ours], [np.array(runs, float) for runs in theirs])])
    return found


def ten(first, last):
    return np.linspace(first, last, 10)


def test_gain_is_the_ratio_of_means_less_one_and_that_of_interquartile_means_stands_beside_it():
    # theirs without its extremes: (2 + 4) / 2 = 3; ours (6 + 6) / 2 = 6
    finding = find(GAIN, [[0, 6, 6, 8]], [[0, 2, 4, 14]])
    assert finding.value == 0.0
    assert finding.middle == 1.0
    assert finding.num_runs == 4


@pytest.mark.parametrize(
    ("measure", "expected"), [("ratio", 1.5), ("gain", 0.5), ("difference", 1.0), ("spread", 2.0 / 1.0 - 1.0)]
)
def test_measures(measure, expected):
    # means 3 and 2; (1, 5) are 2 from their median, (1, 3) 1
    claim = dataclasses.replace(GAIN, measure=measure)
    assert find(claim, [[1, 5]], [[1, 3]]).value == pytest.approx(expected)


@pytest.mark.parametrize(
    ("ours", "verdict"), [(ten(10, 12), "holds"), (ten(1, 3), "does not hold"), (ten(4, 9), "undecided"), ([10] * 9, "points")]
)
def test_a_claim_is_decided_where_its_sides_are_apart(ours, verdict):
    assert find(GAIN, [ours], [ten(5, 7)]).verdict == verdict


@pytest.mark.parametrize("measure", ["ratio", "gain", "difference", "spread"])
def test_a_verdict_is_that_of_the_interval_where_there_is_one_claim(measure):
    rng = np.random.default_rng(0)
    claim = dataclasses.replace(GAIN, measure=measure, at_least=1.0 if measure == "ratio" else 0.0)
    seen = set()
    for shift in np.linspace(-0.6, 0.6, 25):
        finding = find(claim, [rng.normal(1.5 + shift, 0.3 + 0.4 * abs(shift), 10)], [rng.normal(1.5, 0.3, 10)])
        low, high = finding.interval
        expected = "holds" if low > claim.at_least else "does not hold" if high < claim.at_least else "undecided"
        assert finding.verdict == expected
        seen.add(expected)
    assert "holds" in seen


def test_an_upper_bound_is_held_to():
    claim = dataclasses.replace(GAIN, measure="ratio", at_least=-np.inf, at_most=0.6)
    assert find(claim, [ten(5, 5.5)], [[10] * 10]).verdict == "holds"
    assert find(claim, [ten(9, 9.5)], [[10] * 10]).verdict == "does not hold"


def test_both_bounds_are_held_to():
    claim = dataclasses.replace(GAIN, measure="ratio", at_least=0.2, at_most=0.6)
    verdicts = [find(claim, [ten(middle - 0.1, middle + 0.1)], [[10] * 10]).verdict for middle in (1, 4, 8)]
    assert verdicts == ["does not hold", "holds", "does not hold"]


def test_of_several_claims_each_needs_more():
    rng = np.random.default_rng(1)
    apart = examine(GAIN, [ten(1.66, 3.66)], [ten(1, 3)])
    assert 0.01 < apart.p_value < 0.05
    alike = [examine(GAIN, [rng.normal(1.0, 0.3, 10)], [rng.normal(1.0, 0.3, 10)]) for _ in range(9)]
    assert decide([apart])[0].verdict == "holds"
    assert decide([apart, *alike])[0].verdict == "undecided"
    points = [examine(GAIN, [np.ones(3)], [np.ones(3)]) for _ in range(9)]
    assert decide([apart, *points])[0].verdict == "holds"  # claims that are not decided anyway do not count


def test_nothing_divided_by_nothing_is_undecided():
    finding = find(GAIN, [[0] * 10], [[0] * 10])
    assert finding.verdict == "undecided"
    assert GAIN.format(finding.value) == "undefined"


def test_paired_runs_stay_together():
    # Runs differ by far more than conditions do; half is lost in every run, so that there is no doubt about the ratio.
    claim = dataclasses.replace(GAIN, measure="ratio", ours=Side("a", None, ("noise",)), theirs=Side("a"))
    before = np.linspace(20.0, 60.0, 10)
    paired = find(claim, [before / 2], [before])
    assert paired.interval == pytest.approx((0.5, 0.5))
    unpaired = find(dataclasses.replace(claim, theirs=Side("b")), [before / 2], [before])
    assert unpaired.interval[1] - unpaired.interval[0] > 0.2


def test_tasks_count_alike():
    # Within a task runs are equal, so the mean is certain: (1 + 3) / 2 against (1 + 1) / 2.
    finding = find(GAIN, [[1] * 10, [3] * 12], [[1] * 11, [1] * 10])
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
