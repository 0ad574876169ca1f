"""Generalised advantage estimation with time-outs told apart from terminations."""

from __future__ import annotations

import torch


def generalized_advantages(
    rewards: torch.Tensor,
    values: torch.Tensor,
    next_value: torch.Tensor,
    terminated: torch.Tensor,
    truncated: torch.Tensor,
    final_values: torch.Tensor,
    *,
    gamma: float,
    gae_lambda: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Estimate advantages and returns, backwards in time (Schulman et al. 2016, eq. 16).

        delta_t = r_t + gamma V(s'_t) - V(s_t)
        A_t     = delta_t + gamma lambda (1 - done_t) A_{t+1}

    V(s'_t) is zero if s'_t is terminal, V(final observation) if the episode was cut by a time limit
    (not the value of the next episode's first observation), else V(s_{t+1}). A step that is both
    terminated and truncated is terminated.

    Args:
        rewards: (T, B).
        values: V(s_t), (T, B).
        next_value: V(s_T), the value of the observation after the last step, (B,).
        terminated: Whether the step ended the episode in a terminal state, bool (T, B).
        truncated: Whether the step hit a time limit, bool (T, B).
        final_values: V(final observation) where `truncated`, ignored elsewhere, (T, B).
        gamma: Discount in [0, 1].
        gae_lambda: Bias-variance trade-off in [0, 1].

    Returns:
        Advantages and returns (advantages + values), each (T, B).
    """
    done = terminated | truncated
    following = torch.cat([values[1:], next_value.unsqueeze(0)])
    following = torch.where(truncated, final_values, following)
    following = torch.where(terminated, torch.zeros_like(following), following)
    deltas = rewards + gamma * following - values
    carry = gamma * gae_lambda * (~done).to(rewards.dtype)

    advantages = torch.empty_like(rewards)
    advantage = torch.zeros_like(next_value)
    for step in reversed(range(rewards.shape[0])):
        advantage = deltas[step] + carry[step] * advantage
        advantages[step] = advantage
    return advantages, advantages + values
