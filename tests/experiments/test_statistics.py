"""Statistics of few runs, against values worked out by hand."""

import numpy as np
import pytest

from maniskill_grpd.experiments import bootstrap_interval, interquartile_mean, performance_profile, probability_of_improvement
from maniskill_grpd.experiments.statistics import resampled_interval


def generator():
    return np.random.default_rng(0)


def test_interquartile_mean_cuts_a_quarter_at_each_end():
    # 8 scores: 2 are cut at each end, (3 + 4 + 5 + 6) / 4 = 4.5, whatever the outliers are.
    assert interquartile_mean(np.array([-1e6, 1, 3, 4, 5, 6, 8, 1e6])) == 4.5


@pytest.mark.parametrize(("scores", "expected"), [([7.0], 7.0), ([1.0, 2.0, 6.0], 3.0), ([0.0, 1.0, 3.0, 100.0], 2.0)])
def test_up_to_three_scores_are_averaged_and_of_four_two_are(scores, expected):
    assert interquartile_mean(np.array(scores)) == expected


def test_interquartile_mean_pools_tasks_or_keeps_them_apart():
    scores = np.array([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0], [4.0, 40.0]])
    # pooled and sorted 1 2 3 4 10 20 30 40: (3 + 4 + 10 + 20) / 4
    assert interquartile_mean(scores) == 9.25
    np.testing.assert_array_equal(interquartile_mean(scores, axis=0), [2.5, 25.0])


def test_no_scores_have_no_interquartile_mean():
    with pytest.raises(ValueError, match="at least one score"):
        interquartile_mean(np.array([]))


def test_interval_of_two_runs_is_their_range():
    # Resamples are {0, 0}, {0, 1}, {1, 0}, {1, 1} with probability 1/4 each: the 2.5 % and 97.5 % quantiles are 0 and 1.
    assert bootstrap_interval(np.array([0.0, 1.0]), generator=generator()) == (0.0, 1.0)


def test_interval_of_the_mean_is_that_of_the_binomial_distribution():
    # Half ones among 100: resampled means are Binomial(100, 1/2) / 100, whose central 95 % lie in [0.40, 0.60].
    scores = np.repeat([0.0, 1.0], 50)
    low, high = bootstrap_interval(scores, np.mean, generator=generator(), num_resamples=20_000)
    assert low == pytest.approx(0.40, abs=0.011)
    assert high == pytest.approx(0.60, abs=0.011)


def test_resampling_stays_within_tasks():
    # Tasks differ, runs of a task do not: resampling across tasks would give an interval, within tasks there is none.
    easy, hard = np.full(5, 1.0), np.full(5, 0.0)
    assert bootstrap_interval([easy, hard], generator=generator()) == (0.5, 0.5)
    low, high = bootstrap_interval(np.concatenate([easy, hard]), generator=generator())
    assert low < 0.5 < high


def test_the_generator_alone_decides_the_interval():
    scores = np.random.default_rng(1).normal(size=10)
    first, second = (bootstrap_interval(scores, generator=generator()) for _ in range(2))
    assert first == second
    assert first != bootstrap_interval(scores, generator=np.random.default_rng(1))


def test_interval_covers_the_truth_about_as_often_as_it_says():
    rng = np.random.default_rng(2)
    hits = 0
    for _ in range(200):
        low, high = bootstrap_interval(rng.normal(size=40), np.mean, generator=rng, confidence=0.8, num_resamples=200)
        hits += low <= 0.0 <= high
    # 0.8 * 200 = 160 with a standard deviation of 5.7; the percentile bootstrap of 40 samples is a little narrow.
    assert 140 <= hits <= 180


def test_one_run_has_no_interval():
    assert np.isnan(bootstrap_interval(np.array([0.5]), generator=generator())).all()
    assert np.isnan(bootstrap_interval([np.array([0.5]), np.array([0.1, 0.2])], generator=generator())).all()


def test_bad_input_is_explained():
    with pytest.raises(ValueError, match="at least one run"):
        bootstrap_interval([np.array([1.0, 2.0]), np.array([])], generator=generator())
    with pytest.raises(ValueError, match=r"within \(0, 1\), got 95"):
        bootstrap_interval(np.arange(4.0), generator=generator(), confidence=95)


def test_the_interval_of_three_runs_goes_from_the_smallest_to_the_largest():
    # Of the 27 equally likely resamples one is all smallest: 3.7 % of them, more than the 2.5 % that are cut.
    # It misses the middle of a symmetric distribution where all three lie on one side of it: 2 / 2^3 = 25 %.
    assert bootstrap_interval(np.array([7.0, 1.0, 2.0]), generator=generator()) == (1.0, 7.0)


def test_equal_arms_of_three_runs_are_told_apart_four_times_too_often():
    """What every page says of verdicts on three seeds."""
    draws, trials = generator(), 1000
    ahead = 0
    for ours, theirs in draws.normal(size=(trials, 2, 3)):
        low, _ = resampled_interval([ours, theirs], _gain, generator=draws, num_resamples=500)
        ahead += low > 0.0
    assert 0.07 < ahead / trials < 0.13  # 0.10 with a standard error of 0.01; nominal 0.025


def _gain(ours, theirs, axis):
    return ours.mean(axis) - theirs.mean(axis)


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
