"""Learning curves, against values worked out by hand."""

import numpy as np
import pytest

from maniskill_grpd.experiments.curves import Curve, efficiency_band, mean_over_training


def curve(steps, scores):
    return Curve(np.array(steps, float), np.array(scores, float))


def test_mean_over_training_is_the_area_over_the_width():
    # trapezia: 100 * (0 + 1) / 2 + 300 * (1 + 1) / 2 = 350, over 400 steps
    assert mean_over_training(curve([100, 200, 500], [0, 1, 1])) == 350 / 400
    assert mean_over_training(curve([100], [0.3])) == 0.3


def test_learning_earlier_scores_more():
    early, late = curve([0, 1, 2, 3], [0, 1, 1, 1]), curve([0, 1, 2, 3], [0, 0, 0, 1])
    assert mean_over_training(early) > mean_over_training(late)


def test_band_ends_where_the_shortest_run_does():
    runs = [curve([10, 20, 30], [0, 2, 4]), curve([10, 30, 50], [1, 3, 9])]
    band = efficiency_band(runs)
    np.testing.assert_array_equal(band.steps, [10, 20, 30])
    np.testing.assert_allclose(band.middle, [0.5, 2.0, 3.5])  # the second run is at 1, 2, 3
    # Two runs half of a difference d from their mean: t of one degree of freedom, 12.706, times d / 2
    np.testing.assert_allclose(band.high - band.middle, 12.706 * np.array([0.5, 0.0, 0.5]), rtol=1e-4)
    np.testing.assert_allclose(band.low + band.high, 2 * band.middle)


def test_one_run_has_a_curve_without_a_band():
    band = efficiency_band([curve([1, 2], [3, 4])])
    np.testing.assert_array_equal(band.middle, [3, 4])
    assert np.isnan(band.low).all()


@pytest.mark.parametrize(("steps", "scores"), [([1, 2], [1]), ([], []), ([2, 1], [0, 0]), ([1, 1], [0, 0])])
def test_bad_curves_are_refused(steps, scores):
    with pytest.raises(ValueError, match="curve"):
        curve(steps, scores)
