"""What a run computes, as short hashes: equal before and after a change that must not change what it does.

A fingerprint has four parts:

- `solver`: the positions of a short rollout of the run's own task, fixed seeds and actions;
- `task`: observations and rewards of that rollout;
- `learner`: the weights of the run's own policy after one small update by its own algorithm, and the metrics of that;
- `code`: the source of all that decides a run, without comments and docstrings, with the versions of the libraries.

The first three are of bits: a change of the text alone leaves them, and they are comparable on one kind of processor only. The
last one is the same on all machines, and changes with every rearrangement. Runs are of the same code if either says so.
"""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import gymnasium as gym
import torch
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

from maniskill_grpd.learning import TrainConfig, Trainer
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.environments import join_actions, make_vector_env
from maniskill_grpd.runs.policy_options import fit_policy_options
from maniskill_grpd.runs.source import fingerprint_code

RECORD_WORLDS, RECORD_STEPS = 2, 10
"""Size of the rollout behind the fingerprint of a task."""
UPDATE_STEPS = 4
"""Steps of the rollout that the fingerprint of a learner learns from."""
FAST = 40.0
"""How many times larger than in the run its steps are, so that they meet the bounds of its algorithm."""


def describe_task(config: TrainConfig) -> dict[str, Any]:
    """Return what the record of a run says about its task, with the run's options and on its device.

    Returns:
        "progress": name and unit of what measures how near the task is to being done; "fingerprint": solver, task and code.
    """
    envs = _make_worlds(config)
    facts = {"progress": dataclasses.asdict(envs.unwrapped.PROGRESS), "fingerprint": _fingerprint_task(envs)}
    envs.close()
    return facts


def describe_training(config: TrainConfig) -> dict[str, Any]:
    """Return what `describe_task` does, and the fingerprint of the learner."""
    envs = _make_worlds(config)
    fingerprint = {**_fingerprint_task(envs), "learner": _fingerprint_learner(config, envs)}
    progress = dataclasses.asdict(envs.unwrapped.PROGRESS)
    envs.close()
    return {"progress": progress, "fingerprint": fingerprint}


def _make_worlds(config: TrainConfig) -> ManiSkillVectorEnv:
    return make_vector_env(config, RECORD_WORLDS, partial_reset=config.partial_reset)


def _fingerprint_task(envs: ManiSkillVectorEnv) -> dict[str, str]:
    """Hash a short rollout, and the source."""
    observed, positions = zip(*_roll_out(envs.unwrapped, RECORD_STEPS), strict=True)
    hashes = {"solver": digest(itertools.chain(*positions)), "task": digest(itertools.chain(*observed))}
    return {**hashes, "code": fingerprint_code()}


def _fingerprint_learner(config: TrainConfig, envs: ManiSkillVectorEnv) -> str:
    """Hash the weights after one update of the run's policy by its algorithm, and the metrics of that update.

    Sizes, seeds and the number of threads are fixed, steps are large; all else that says how it learns is the run's own.
    """
    small = dataclasses.replace(
        config,
        **{"seed": 0, "num_envs": RECORD_WORLDS, "num_steps": UPDATE_STEPS, "total_timesteps": RECORD_WORLDS * UPDATE_STEPS},
        **{"num_minibatches": 2, "update_epochs": 2, "compile": False, "resume": None, "checkpoint": None},
        **{"learning_rate": FAST * config.learning_rate},
    )
    num_threads = torch.get_num_threads()
    with torch.random.fork_rng():
        torch.set_num_threads(1)
        torch.manual_seed(small.seed)
        options = fit_policy_options(small.policy_options, envs)
        policy = make_policy(small.policy, envs.unwrapped.graph_schema, **options).to(envs.device)
        trainer = Trainer(small, policy, envs)
        trainer.start_episodes()
        _, _, losses = trainer.collect_and_learn()
        torch.set_num_threads(num_threads)
    # Metrics too: a step that was too large may have been taken back altogether.
    metrics = torch.tensor([losses[name] for name in sorted(losses)], dtype=torch.float64)
    return digest([*policy.parameters(), metrics])


def hash_trajectories(env: gym.Env, num_steps: int) -> str:
    """Step a task with fixed seeds and actions and hash what it returns.

    Hashes are of bits: they are comparable on one machine and with one set of library versions only.

    Args:
        env: A batched task with graph observations; it is reset.
        num_steps: Steps after the reset.

    Returns:
        See `digest`; over the observations of the reset, and observations, rewards and positions of every step.
    """
    return digest(value for step in _roll_out(env, num_steps) for values in step for value in values)


def _roll_out(env: gym.Env, num_steps: int) -> list[tuple[list[torch.Tensor], list[torch.Tensor]]]:
    """Return, for the reset and every step, what is observed, rewards included, and the positions of all nodes after it."""
    base, env = env.unwrapped, join_actions(env)
    generator = torch.Generator().manual_seed(7)
    obs, _ = env.reset(seed=11)
    steps = [([value.clone() for value in tensors(obs)], [])]
    size = env.action_space.shape[-1]
    for _ in range(num_steps):
        action = 2.0 * torch.rand(base.num_envs, size, generator=generator) - 1.0
        obs, reward, *_ = env.step(action)
        steps.append(([value.clone() for value in (*tensors(obs), reward)], [base.solver.positions.clone()]))
    return steps


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
