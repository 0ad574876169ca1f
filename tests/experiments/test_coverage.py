"""How often intervals of ten runs cover, and how often claims that are not true are said to hold: Monte Carlo.

Standard errors of the shares are below 0.005. Comparisons, of which all verdicts are made, cover within [0.93, 0.97] and are
decided wrongly in at most 3 % whatever scores look like; so do intervals of one mean unless scores are skewed strongly. Where
they fail is asserted too.
"""

import numpy as np
import pytest

from maniskill_grpd.experiments.claim import MIN_RUNS
from maniskill_grpd.experiments.statistics import contrast, deviations, estimate, holm, interquartile_mean, ratio_interval

TRIALS = 2500


def heaps(rng, shape):
    """Seven of ten seeds learn the task."""
    return np.where(rng.random(shape) < 0.7, rng.normal(0.9, 0.05, shape), rng.normal(0.1, 0.05, shape))


def success(rng, shape):
    """Success in 50 episodes of policies most of which are good."""
    return rng.binomial(50, rng.beta(8.0, 2.0, shape)) / 50.0


DISTRIBUTIONS = {
    "normal": lambda rng, shape: rng.normal(1.0, 0.3, shape),
    "uniform": lambda rng, shape: rng.uniform(0.0, 1.0, shape),
    "skewed": lambda rng, shape: np.exp(0.5 * rng.normal(size=shape)),
    "success": success,
    "heaps": heaps,
}


def draw(name, *shape, seed=0):
    return DISTRIBUTIONS[name](np.random.default_rng(seed), shape)


def mean_coverage(scores, truth):
    hits = [low <= truth <= high for low, high in (estimate(runs).interval() for runs in scores)]
    return np.mean(hits)


@pytest.mark.parametrize("name", ["normal", "uniform", "success", "heaps"])
def test_intervals_of_a_mean_cover(name):
    truth = draw(name, 400_000, seed=1).mean()
    assert 0.93 <= mean_coverage(draw(name, TRIALS, MIN_RUNS), truth) <= 0.97


def test_intervals_of_one_mean_of_strongly_skewed_scores_cover_less():
    truth = draw("skewed", 400_000, seed=1).mean()
    assert 0.90 <= mean_coverage(draw("skewed", TRIALS, MIN_RUNS), truth) < 0.935
    # Nearly all seeds at 1: the few others decide, and are often not among ten.
    rng = np.random.default_rng(2)
    assert 0.86 <= mean_coverage(rng.beta(5.0, 0.5, (TRIALS, MIN_RUNS)), 5.0 / 5.5) < 0.92


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_intervals_of_comparisons_cover(name):
    ours, theirs = draw(name, 2, TRIALS, MIN_RUNS)
    differences = [contrast([x], [y], 1.0, is_paired=False).interval() for x, y in zip(ours, theirs, strict=True)]
    assert 0.93 <= np.mean([low <= 0.0 <= high for low, high in differences]) <= 0.97
    ratios = [ratio_interval([x], [y], is_paired=False) for x, y in zip(ours[:400], theirs[:400], strict=True)]
    assert 0.92 <= np.mean([not (low > 1.0 or high < 1.0) for low, high in ratios]) <= 0.98


def is_said_to_hold(ours, theirs):
    """Return whether the mean of ours is told to be larger, as a claim alone is decided."""
    return contrast([ours], [theirs], 1.0, is_paired=False).p_above() <= 0.025


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("transformed", [np.asarray, deviations], ids=["mean", "spread"])
def test_equal_arms_are_rarely_told_apart(name, transformed):
    wrong = [is_said_to_hold(transformed(x), transformed(y)) for x, y in zip(*draw(name, 2, TRIALS, MIN_RUNS), strict=True)]
    assert np.mean(wrong) <= 0.03 + 0.003  # 0.025 are allowed; the standard error of so many trials is 0.003


def test_of_a_whole_study_of_equal_arms_one_claim_in_twenty_studies_is_decided():
    """Without Holm's correction it is one in three."""
    rng = np.random.default_rng(3)
    p_values = np.array(
        [
            [contrast([x], [y], 1.0, is_paired=False).p_above() for x, y in rng.normal(1.0, 0.3, (8, 2, MIN_RUNS))]
            for _ in range(500)
        ]
    )
    two_sided = 2.0 * np.minimum(p_values, 1.0 - p_values)
    assert np.mean([min(holm(row)) <= 0.05 for row in two_sided]) <= 0.08  # 0.05 with a standard error of 0.01
    assert (two_sided.min(axis=1) <= 0.05).mean() >= 0.25


def test_a_difference_of_two_deviations_is_seen():
    rng = np.random.default_rng(4)
    pairs = zip(rng.normal(1.6, 0.3, (300, 10)), rng.normal(1.0, 0.3, (300, 10)), strict=True)
    assert np.mean([is_said_to_hold(x, y) for x, y in pairs]) > 0.95


def test_intervals_of_interquartile_means_do_not_cover_scores_in_two_heaps():
    """Why means are compared: the middle of ten runs, seven of which learn, is often all of one heap."""
    scores = draw("heaps", TRIALS, MIN_RUNS)
    truth = np.mean([interquartile_mean(runs) for runs in draw("heaps", 20_000, MIN_RUNS, seed=1)])
    ordered = np.sort(scores, axis=1)
    winsorised = np.clip(scores, ordered[:, 2:3], ordered[:, 7:8])
    error = winsorised.std(axis=1, ddof=1) * np.sqrt(9 / (6 * 5))  # Yuen's
    middle = ordered[:, 2:8].mean(axis=1)
    assert np.mean(np.abs(middle - truth) <= 2.57 * error) < 0.8
