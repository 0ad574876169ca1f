"""Statistics of few runs, against values worked out by hand and against scipy."""

import math

import numpy as np
import pytest
from scipy import stats

from maniskill_grpd.experiments import estimate, interquartile_mean, performance_profile, probability_of_improvement
from maniskill_grpd.experiments.statistics import contrast, deviations, effect_size, holm, ratio_interval

RNG = np.random.default_rng(0)
OURS, THEIRS = RNG.normal(3.0, 1.0, 12), RNG.normal(2.0, 0.3, 10)


def test_interval_of_a_mean_is_that_of_student():
    # Scores 0, 1, 2: mean 1, deviation 1, error 1 / sqrt(3), and t of two degrees of freedom is 4.3027 at 97.5 %.
    low, high = estimate(np.array([0.0, 1.0, 2.0])).interval()
    assert (low + high) / 2 == pytest.approx(1.0)
    assert (high - low) / 2 == pytest.approx(4.3027 / math.sqrt(3), abs=1e-4)


def test_every_task_counts_alike_however_many_runs_it_has():
    found = estimate([np.array([1.0, 3.0]), np.array([10.0, 10.0, 10.0, 10.0])])
    assert found.value == pytest.approx((2.0 + 10.0) / 2)
    # variance of the first mean 2 / 2 = 1, of the second 0; of their mean 1 / 4, with the one degree of freedom of the first
    assert found.error == pytest.approx(0.5)
    assert found.degrees == pytest.approx(1.0)


def test_p_values_of_a_difference_are_those_of_welch():
    found = contrast([OURS], [THEIRS], 1.0, is_paired=False)
    expected = stats.ttest_ind(OURS, THEIRS, equal_var=False, alternative="greater")
    assert found.p_above() == pytest.approx(expected.pvalue)
    interval = stats.ttest_ind(OURS, THEIRS, equal_var=False).confidence_interval(0.95)
    assert found.interval() == pytest.approx((interval.low, interval.high))


def test_paired_runs_are_compared_one_by_one():
    ours = THEIRS + np.linspace(0.1, 0.2, len(THEIRS))
    found = contrast([ours], [THEIRS], 1.0, is_paired=True)
    assert found.p_above() == pytest.approx(stats.ttest_rel(ours, THEIRS, alternative="greater").pvalue)
    assert found.error < contrast([ours], [THEIRS], 1.0, is_paired=False).error / 3


@pytest.mark.parametrize("is_paired", [False, True])
def test_ends_of_a_ratio_are_the_factors_at_which_the_contrast_may_be_zero(is_paired):
    ours = OURS[: len(THEIRS)]
    for end in ratio_interval([ours], [THEIRS], is_paired=is_paired):
        found = contrast([ours], [THEIRS], end, is_paired=is_paired)
        assert min(found.p_above(), 1.0 - found.p_above()) == pytest.approx(0.025, abs=1e-6)


def test_a_ratio_to_what_may_be_zero_is_not_known():
    assert np.isnan(ratio_interval([OURS], [RNG.normal(size=10)], is_paired=False)).all()


def test_a_ratio_without_spread_is_certain():
    assert ratio_interval([np.full(10, 3.0)], [np.full(10, 2.0)], is_paired=False) == (1.5, 1.5)


@pytest.mark.parametrize(("value", "expected"), [(2.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
def test_scores_without_spread_are_above_a_bound_or_not(value, expected):
    assert estimate(np.full(10, value)).p_above(1.0) == expected


def test_one_run_says_nothing_about_the_spread():
    for scores in (np.array([0.5]), [np.array([0.5]), np.array([0.1, 0.2])]):
        assert np.isnan(estimate(scores).interval()).all()
        assert np.isnan(estimate(scores).p_above())


def test_bad_input_is_explained():
    with pytest.raises(ValueError, match="at least one run"):
        estimate([np.array([1.0, 2.0]), np.array([])])
    with pytest.raises(ValueError, match=r"within \(0, 1\), got 95"):
        estimate(np.arange(4.0)).interval(95)


def test_holm_counts_the_smallest_as_often_as_there_are():
    # 0.01 * 3, then max(0.03, 0.02 * 2), then max(0.04, 0.5)
    np.testing.assert_allclose(holm([0.02, 0.5, 0.01]), [0.04, 0.5, 0.03])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_effect_is_the_difference_in_deviations():
    # means 3 and 1, pooled deviation sqrt(2), four runs: the correction is 1 - 3 / 7
    assert effect_size([np.array([2.0, 4.0])], [np.array([0.0, 2.0])], is_paired=False) == pytest.approx(2 / math.sqrt(2) * 4 / 7)
    assert math.isnan(effect_size([np.ones(3)], [np.zeros(3)], is_paired=False))


def test_deviations_are_from_the_median():
    np.testing.assert_array_equal(deviations(np.array([1.0, 2.0, 10.0])), [1.0, 0.0, 8.0])


def test_interquartile_mean_cuts_a_quarter_at_each_end():
    # 8 scores: 2 are cut at each end, (3 + 4 + 5 + 6) / 4 = 4.5, whatever the outliers are.
    assert interquartile_mean(np.array([-1e6, 1, 3, 4, 5, 6, 8, 1e6])) == 4.5


@pytest.mark.parametrize(("scores", "expected"), [([7.0], 7.0), ([1.0, 2.0, 6.0], 3.0), ([0.0, 1.0, 3.0, 100.0], 2.0)])
def test_up_to_three_scores_are_averaged_and_of_four_two_are(scores, expected):
    assert interquartile_mean(np.array(scores)) == expected


def test_no_scores_have_no_interquartile_mean():
    with pytest.raises(ValueError, match="at least one score"):
        interquartile_mean(np.array([]))


def test_probability_of_improvement_counts_pairs():
    # Of the pairs (2, 1) (2, 2) (3, 1) (3, 2) three are won and one is a tie.
    assert probability_of_improvement(np.array([2.0, 3.0]), np.array([1.0, 2.0])) == 3.5 / 4
    # A second task that is lost altogether counts as much, although it has more runs.
    ours, theirs = [np.array([2.0, 3.0]), np.zeros(5)], [np.array([1.0, 2.0]), np.ones(5)]
    assert probability_of_improvement(ours, theirs) == 3.5 / 8


def test_both_sides_are_probabilities_of_one():
    rng = np.random.default_rng(3)
    ours, theirs = rng.integers(0, 5, 7), rng.integers(0, 5, 9)
    assert probability_of_improvement(ours, theirs) + probability_of_improvement(theirs, ours) == pytest.approx(1.0)


def test_improvement_needs_the_same_tasks():
    with pytest.raises(ValueError, match="same tasks, got 1 and 2"):
        probability_of_improvement([np.arange(3.0)], [np.arange(3.0), np.arange(3.0)])


def test_performance_profile_is_the_share_above_each_threshold():
    shares = performance_profile([np.array([0.2, 0.6, 0.8, 1.0]), np.array([0.0, 0.9])], np.array([0.0, 0.5, 0.6, 1.0]))
    # first task 1, 3/4, 2/4, 0; second 1/2, 1/2, 1/2, 0
    np.testing.assert_allclose(shares, [0.75, 0.625, 0.5, 0.0])


def test_rliable_agrees_where_it_is_installed():
    metrics = pytest.importorskip("rliable.metrics", exc_type=ImportError)
    scores = np.random.default_rng(4).normal(size=(10, 4))
    assert interquartile_mean(scores) == pytest.approx(metrics.aggregate_iqm(scores))
    other = np.random.default_rng(5).normal(size=(8, 4))
    assert probability_of_improvement(list(scores.T), list(other.T)) == pytest.approx(
        metrics.probability_of_improvement(scores, other)
    )
