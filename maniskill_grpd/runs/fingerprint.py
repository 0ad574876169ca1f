"""The behaviour of a task as one number: equal before and after a change that must not change what it does."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Iterator
from typing import Any

import gymnasium as gym
import torch

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.environments import make_env

RECORD_WORLDS, RECORD_STEPS = 2, 5
"""Size of the fingerprint in the record of a run, which is taken at the start of every training."""


def hash_trajectories(env: gym.Env, num_steps: int) -> str:
    """Step a task with fixed seeds and actions and hash what it returns.

    Hashes are of bits: they are comparable on one machine and with one set of library versions only.

    Args:
        env: A batched task with graph observations; it is reset.
        num_steps: Steps after the reset.

    Returns:
        See `digest`; over the observations of the reset, and observations, rewards and positions of every step.
    """
    base = env.unwrapped
    generator = torch.Generator().manual_seed(7)
    obs, _ = env.reset(seed=11)
    seen = [value.clone() for value in tensors(obs)]
    size = base.single_action_space.shape[0]
    for _ in range(num_steps):
        action = 2.0 * torch.rand(base.num_envs, size, generator=generator) - 1.0
        obs, reward, *_ = env.step(action)
        seen += [value.clone() for value in (*tensors(obs), reward, base.solver.positions)]
    return digest(seen)


def describe_task(config: TrainConfig) -> dict[str, Any]:
    """Return what the record of a run says about its task, with the run's options and on its device.

    Returns:
        "progress": name and unit of what measures how near the task is to being done; "fingerprint": the hash of short
        trajectories.
    """
    env = make_env(config, RECORD_WORLDS)
    facts = {"progress": dataclasses.asdict(env.unwrapped.PROGRESS), "fingerprint": hash_trajectories(env, RECORD_STEPS)}
    env.close()
    return facts


def digest(values: Iterable[torch.Tensor]) -> str:
    """Return the first 16 digits of the SHA-256 of tensors, bit by bit."""
    total = hashlib.sha256()
    for value in values:
        total.update(value.detach().cpu().contiguous().numpy().tobytes())
    return total.hexdigest()[:16]


def tensors(value: Any) -> Iterator[torch.Tensor]:
    """Yield the tensors of a nested dictionary in the order of their names."""
    if isinstance(value, dict):
        for key in sorted(value):
            yield from tensors(value[key])
    elif isinstance(value, torch.Tensor):
        yield value
