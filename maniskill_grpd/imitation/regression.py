"""Fitting the action distribution of a policy to demonstrated actions."""

from __future__ import annotations

import time
from typing import Any

import torch
from torch.nn.functional import binary_cross_entropy_with_logits
from tqdm import tqdm

from maniskill_grpd.imitation.clone_config import CloneConfig
from maniskill_grpd.imitation.demonstrations import Demonstrations
from maniskill_grpd.policies import ActionDistribution, Policy

MAX_GRAD_NORM = 1.0
VALUE_WEIGHT = 0.1
"""Weight of the squared error of values beside the loss of the actions, which share layers with them."""
EVALUATION_CHUNK = 1000
"""Observations per forward pass of the validation."""


def train_policy(
    policy: Policy, demonstrations: Demonstrations, config: CloneConfig, values: torch.Tensor | None = None
) -> dict[str, Any]:
    """Fit the distribution of a policy to demonstrated actions, and its value function if there are values to learn.

    Args:
        policy: Changed in place; its normaliser takes its scales from the training episodes.
        demonstrations: What to learn.
        config: Options of the training.
        values: What the value network is to give at each observation, (M,), of order one.

    Returns:
        Errors on training and held-out episodes, processor seconds, gradient steps.
    """
    generator = torch.Generator().manual_seed(config.seed)
    num_held_out = max(1, round(config.validation_share * demonstrations.num_episodes))
    train, held_out = demonstrations.split(num_held_out, generator)
    if not len(train):
        raise ValueError(f"all {num_held_out} episodes are held out; give more episodes or a smaller validation_share")
    policy.normalizer.update(demonstrations.select(train)[0])
    optimizer = torch.optim.Adam(policy.parameters(), lr=config.learning_rate)
    num_batches = -(-len(train) // config.batch_size)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, config.epochs * num_batches)
    start, history = time.process_time(), []
    with tqdm(range(config.epochs), desc=policy.name, unit="epoch") as progress:
        for _ in progress:
            order = train[torch.randperm(len(train), generator=generator)]
            for index in order.split(config.batch_size):
                target = None if values is None else values[index]
                gradient_step(policy, optimizer, *demonstrations.select(index), config.loss, target)
                schedule.step()
            history.append(relative_error(policy, demonstrations, held_out))
            progress.set_postfix_str(f"validation error {history[-1]:.1%}")
    return {
        "validation_error": history[-1],
        "train_error": relative_error(policy, demonstrations, train),
        "validation_history": history,
        "gradient_steps": config.epochs * num_batches,
        "cpu_seconds": time.process_time() - start,
    }


def gradient_step(
    policy: Policy,
    optimizer: torch.optim.Optimizer,
    graph: dict[str, Any],
    actions: torch.Tensor,
    loss: str,
    values: torch.Tensor | None = None,
) -> None:
    """Take one step on M demonstrated actions (M, A, 3), and values (M,) if there are any."""
    optimizer.zero_grad(set_to_none=True)
    if values is None:
        error = LOSSES[loss](policy.distribution(graph), actions)
    else:
        distribution, output = policy(graph)
        error = LOSSES[loss](distribution, actions) + VALUE_WEIGHT * (output - values).square().mean()
    error.backward()
    torch.nn.utils.clip_grad_norm_(policy.parameters(), MAX_GRAD_NORM)
    optimizer.step()


def mean_squared_error(dist: ActionDistribution, actions: torch.Tensor) -> torch.Tensor:
    """Mean of |mean - action|^2 over all actuators that are not masked, plus the negative log-likelihood of grips; a scalar."""
    error = (dist.mean - actions[..., :3]).square().sum(-1)
    if dist.gripper_logits is not None:
        error = error + binary_cross_entropy_with_logits(dist.gripper_logits, actions[..., 3], reduction="none")
    return error[dist.mask].mean()


def negative_log_likelihood(dist: ActionDistribution, actions: torch.Tensor) -> torch.Tensor:
    """Mean negative log-likelihood of the joint actions [nats]; a scalar."""
    return -dist.log_prob(actions).mean()


LOSSES = {"mse": mean_squared_error, "nll": negative_log_likelihood}


@torch.no_grad()
def relative_error(policy: Policy, demonstrations: Demonstrations, index: torch.Tensor) -> float:
    """Root mean square of |mean - action| over that of |action|; 1 for standing still."""
    error = size = 0.0
    for part in index.split(EVALUATION_CHUNK):
        graph, actions = demonstrations.select(part)
        dist = policy.distribution(graph)
        error += (dist.mean - actions[..., :3]).square().sum(-1)[dist.mask].sum().item()
        size += actions[..., :3].square().sum(-1)[dist.mask].sum().item()
    return (error / size) ** 0.5
