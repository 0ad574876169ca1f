"""How distributions of plans move towards the good ones, against numbers worked out by hand."""

import pytest
import torch

from maniskill_grpd.planning.cross_entropy import MEMORY, SMALLEST_STD, CrossEntropy
from maniskill_grpd.planning.options import PlannerOptions
from maniskill_grpd.planning.path_integral import PathIntegral

PLANS = torch.tensor([0.0, 1.0, 2.0, 3.0])[None, :, None, None]
ZERO = torch.zeros(1, 1, 1)


def test_cross_entropy_takes_mean_and_deviation_of_the_best_half():
    """The best are 1 and 3: mean 2, deviation sqrt 2; a tenth of the old mean 0 and deviation 1 stays."""
    options = PlannerOptions(samples=4, elite_share=0.5, horizon=1, replan=1)
    returns = torch.tensor([[0.0, 5.0, 1.0, 4.0]])
    mean, std = CrossEntropy(options).refit(ZERO, ZERO + 1.0, PLANS, returns)
    assert mean.item() == pytest.approx((1.0 - MEMORY) * 2.0)
    assert std.item() == pytest.approx((1.0 - MEMORY) * 2.0**0.5 + MEMORY)


def test_equal_elites_leave_a_spread():
    options = PlannerOptions(samples=4, elite_share=0.5, horizon=1, replan=1)
    _, std = CrossEntropy(options).refit(ZERO, ZERO, torch.ones_like(PLANS), torch.zeros(1, 4))
    assert std.item() == pytest.approx((1.0 - MEMORY) * SMALLEST_STD)


def test_path_integral_weighs_by_the_exponential_of_returns_in_their_deviations():
    options = PlannerOptions(method="mppi", samples=4, temperature=0.5, horizon=1, replan=1)
    returns = torch.tensor([[0.0, 1.0, 2.0, 3.0]])
    weights = torch.exp(returns[0] / (0.5 * returns.std()))
    expected = (weights * PLANS.flatten()).sum() / weights.sum()
    mean, std = PathIntegral(options).refit(ZERO, ZERO + 1.0, PLANS, returns)
    assert mean.item() == pytest.approx(expected.item())
    assert std.item() == 1.0
    shifted, _ = PathIntegral(options).refit(ZERO, ZERO + 1.0, PLANS, 100.0 * returns + 7.0)
    torch.testing.assert_close(shifted, mean)  # the scale and the zero of rewards mean nothing


def test_equal_returns_weigh_the_same():
    options = PlannerOptions(method="mppi", samples=4, horizon=1, replan=1)
    mean, _ = PathIntegral(options).refit(ZERO, ZERO, PLANS, torch.full((1, 4), 3.0))
    assert mean.item() == pytest.approx(1.5)
