"""Advantages worked by hand."""

import torch

from maniskill_grpd.learning.gae import generalized_advantages

GAMMA, LAMBDA = 0.5, 0.5
REWARDS = torch.tensor([[1.0], [2.0], [4.0]])
VALUES = torch.tensor([[2.0], [4.0], [8.0]])
NEXT_VALUE = torch.tensor([16.0])


def estimate(terminated_at=None, truncated_at=None, final_value=0.0):
    """Estimate for the sequence above, with an episode end after a given step."""
    terminated = torch.zeros(3, 1, dtype=torch.bool)
    truncated = torch.zeros(3, 1, dtype=torch.bool)
    final_values = torch.full((3, 1), torch.nan)  # must not be read where nothing was truncated
    if terminated_at is not None:
        terminated[terminated_at] = True
    if truncated_at is not None:
        truncated[truncated_at] = True
        final_values[truncated_at] = final_value
    advantages, returns = generalized_advantages(
        REWARDS, VALUES, NEXT_VALUE, terminated, truncated, final_values, gamma=GAMMA, gae_lambda=LAMBDA
    )
    torch.testing.assert_close(returns, advantages + VALUES)
    return advantages.flatten().tolist()


def test_an_unbroken_rollout_bootstraps_from_the_next_value():
    # delta_2 = 4 + 0.5 * 16 - 8 = 4                  A_2 = 4
    # delta_1 = 2 + 0.5 * 8 - 4 = 2                   A_1 = 2 + 0.25 * 4 = 3
    # delta_0 = 1 + 0.5 * 4 - 2 = 1                   A_0 = 1 + 0.25 * 3 = 1.75
    assert estimate() == [1.75, 3.0, 4.0]


def test_a_termination_has_no_future():
    # delta_1 = 2 + 0 - 4 = -2, nothing carried       A_1 = -2
    # delta_0 = 1                                     A_0 = 1 + 0.25 * -2 = 0.5
    assert estimate(terminated_at=1) == [0.5, -2.0, 4.0]


def test_a_time_out_bootstraps_from_its_own_final_observation():
    # delta_1 = 2 + 0.5 * 6 - 4 = 1, nothing carried  A_1 = 1   (V(s_2) = 8 is of the next episode)
    # delta_0 = 1                                     A_0 = 1.25
    assert estimate(truncated_at=1, final_value=6.0) == [1.25, 1.0, 4.0]


def test_a_time_out_at_the_last_step_does_not_see_the_next_episode():
    # delta_2 = 4 + 0.5 * 6 - 8 = -1                  A_2 = -1
    # A_1 = 2 + 0.25 * -1 = 1.75                      A_0 = 1 + 0.25 * 1.75 = 1.4375
    assert estimate(truncated_at=2, final_value=6.0) == [1.4375, 1.75, -1.0]


def test_a_termination_at_the_time_limit_is_a_termination():
    assert estimate(terminated_at=1, truncated_at=1, final_value=6.0) == estimate(terminated_at=1)


def test_lambda_one_gives_discounted_returns():
    # R_2 = 4 + 0.5 * 16 = 12, R_1 = 2 + 6 = 8, R_0 = 1 + 4 = 5
    none = torch.zeros(3, 1, dtype=torch.bool)
    _, returns = generalized_advantages(REWARDS, VALUES, NEXT_VALUE, none, none, torch.zeros(3, 1), gamma=0.5, gae_lambda=1.0)
    assert returns.flatten().tolist() == [5.0, 8.0, 12.0]
