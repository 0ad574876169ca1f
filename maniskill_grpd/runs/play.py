"""Play a policy: one episode per seed, on the task of its training or on another."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import torch

from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.checkpoints import check_schema
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.runs.noisy_observer import NoisyObserver


def play(
    policy: Policy, task: TrainConfig, seeds: Sequence[int], num_envs: int, *, sigma: float = 0.0, stochastic: bool = False
) -> dict[str, torch.Tensor]:
    """Play one episode per seed in an environment made for it.

    Args:
        policy: The policy.
        task: Names the task and its options.
        seeds: One per episode; the first also seeds the noise.
        num_envs: Most environments that run in parallel.
        sigma: Noise on observed positions [m] and velocities [m/s].
        stochastic: Whether to sample actions.

    Returns:
        Results per episode, as `evaluate_policy` gives them.

    Raises:
        CheckpointError: If the policy was trained on other observations than the task gives.
    """
    env = make_env(task, min(num_envs, len(seeds)))
    check_schema(policy, env)
    device = env.unwrapped.device
    policy.to(device)
    action_noise, observation_noise = (torch.Generator(device).manual_seed(seeds[0] + offset) for offset in (0, 1))
    actor = NoisyObserver(policy, sigma, observation_noise) if sigma else policy
    episodes = evaluate_policy(actor, env, seeds, not stochastic, generator=action_noise if stochastic else None)
    env.close()
    return episodes


def change_task(
    trained: TrainConfig, env_id: str | None = None, env_kwargs: Sequence[str] = (), sim_backend: str | None = None
) -> TrainConfig:
    """Return the options of a training with another task.

    Args:
        trained: The options.
        env_id: Id of the task, if not the same.
        env_kwargs: Options of the task as key=value pairs, which replace or extend those of the training.
        sim_backend: Where the simulation runs, if not as in training.
    """
    given = {pair.partition("=")[0] for pair in env_kwargs}
    kept = tuple(pair for pair in trained.env_kwargs if pair.partition("=")[0] not in given)
    return dataclasses.replace(
        trained, env_id=env_id or trained.env_id, env_kwargs=(*kept, *env_kwargs), sim_backend=sim_backend or trained.sim_backend
    )
