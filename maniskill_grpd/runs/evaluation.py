"""Evaluate a checkpoint on unseen start and goal poses."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import THREADS, check_ranges, require_positive
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.noisy_observer import NoisyObserver
from maniskill_grpd.runs.play import change_task, play
from maniskill_grpd.runs.replays import record_replay, worst_and_median
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Options of an evaluation."""

    checkpoint: Path
    """the checkpoint to evaluate"""
    num_episodes: int = 200
    """number of episodes, each with its own seed"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode; training uses seeds from 2**30 up, so smaller ones are unseen"""
    num_envs: int = 50
    """number of environments that run in parallel"""
    env_id: str | None = None
    """id of the task, if not the one of the training"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs that replace or extend those of the training"""
    sim_backend: str | None = None
    """where the simulation runs (auto, cpu, cuda), if not as in training"""
    stochastic: bool = False
    """sample actions instead of taking the mean"""
    sigma: float = 0.0
    """standard deviation of noise on observed positions [m] and velocities [m/s]"""
    allow_import: bool = False
    """whether the id of the task in the checkpoint may be of the form module:id, which runs the code of that module"""
    torch_threads: int = 1
    """CPU threads PyTorch uses"""
    video: Path | None = None
    """also write a video of the first four episodes, side by side, to this mp4"""
    html: Path | None = None
    """also write a replay of the worst and the median episode to this file"""
    json: Path | None = None
    """also write the results, per episode, to this file"""
    card: Path | None = None
    """also write a page about the checkpoint, with these results, to this file"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_envs")
        check_ranges(self, {"torch_threads": THREADS, "sigma": "[0, inf)"})


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """What an evaluation found.

    Attributes:
        policy: The policy that was played.
        contents: The other contents of its checkpoint.
        task: Names the task that was played and its options.
        episodes: Results per episode, as `evaluate_policy` gives them.
    """

    policy: Policy
    contents: dict[str, Any]
    task: TrainConfig
    episodes: dict[str, torch.Tensor]

    @property
    def global_step(self) -> int:
        """Environment steps that the policy was trained for."""
        return self.contents["global_step"]


def evaluate(config: EvaluationConfig) -> Evaluation:
    """Evaluate as configured.

    Raises:
        CheckpointError: If the file is no checkpoint, or of a policy for other observations than the task gives.
        ValueError: If the task does not exist or does not take its options.
    """
    torch.set_num_threads(config.torch_threads)
    policy, contents = load_policy(config.checkpoint, allow_import=config.allow_import)
    trained = TrainConfig.from_dict(contents["train_config"])
    task = change_task(trained, config.env_id, config.env_kwargs, config.sim_backend)
    seeds = range(config.seed, config.seed + config.num_episodes)
    episodes = play(policy, task, seeds, config.num_envs, sigma=config.sigma, stochastic=config.stochastic)
    return Evaluation(policy=policy, contents=contents, task=task, episodes=episodes)


def record_worst_and_median(config: EvaluationConfig, found: Evaluation) -> Path:
    """Play the worst and the median episode of an evaluation again, and write their replay; noise is drawn anew.

    Raises:
        ValueError: If the evaluation has no file for a replay.
    """
    if config.html is None:
        raise ValueError("the evaluation has no file for a replay: --html")
    chosen = worst_and_median(found.episodes["return"])
    told = [f"{name} episode: seed {config.seed + which}, return {found.episodes['return'][which]:.1f}"
            for name, which in zip(("worst", "median"), chosen, strict=True)]  # fmt: skip
    noise = torch.Generator(next(found.policy.parameters()).device).manual_seed(config.seed + 1)
    actor = NoisyObserver(found.policy, config.sigma, noise) if config.sigma else found.policy
    seeds = [config.seed + which for which in chosen]
    title = f"{found.task.env_id}, {config.checkpoint.name}, of {config.num_episodes} episodes. Left, {told[0]}; right, {told[1]}"
    record_replay(actor, found.task, seeds, config.html, title, stochastic=config.stochastic)
    return config.html
