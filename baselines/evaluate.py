"""Evaluate a checkpoint on unseen start and goal poses.

python baselines/evaluate.py --checkpoint runs/NAME/final_ckpt.pt --num_episodes 200

The task and its options are those the policy was trained on unless others are given: another number of nodes or grippers is
fine, a task with other observation channels is refused.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro
from checkpoint_card import write_card
from record_video import record_video
from run_setup import check_schema, describe_episodes, load_policy, make_env

from maniskill_grpd.experiments import NoisyObserver
from maniskill_grpd.learning import CheckpointError, TrainConfig, evaluate_policy
from maniskill_grpd.learning.config import require_positive
from maniskill_grpd.policies import Policy


@dataclass(frozen=True, kw_only=True)
class EvalConfig:
    """Options of an evaluation."""

    checkpoint: str
    """the checkpoint to evaluate"""
    num_episodes: int = 200
    """number of episodes, each with its own seed"""
    seed: int = 1_000_000
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
    json: Path | None = None
    """also write the results, per episode, to this file"""
    card: Path | None = None
    """also write a page about the checkpoint, with these results, to this file"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_envs", "torch_threads")
        if not self.sigma >= 0.0:
            raise ValueError(f"sigma must not be negative, got {self.sigma}")


def evaluate(config: EvalConfig, arguments: Sequence[str] = ()) -> dict[str, torch.Tensor]:
    """Evaluate as configured and print a table.

    Args:
        config: Options.
        arguments: The command line that gave them, for the card.

    Returns:
        Results per episode, as `evaluate_policy` gives them.
    """
    torch.set_num_threads(config.torch_threads)
    policy, contents = load_policy(config.checkpoint, allow_import=config.allow_import)
    task = task_config(config, TrainConfig.from_dict(contents["train_config"]))
    seeds = range(config.seed, config.seed + config.num_episodes)
    episodes = play(policy, task, seeds, config.num_envs, sigma=config.sigma, stochastic=config.stochastic)
    print(
        f"{task.env_id} {' '.join(task.env_kwargs)}: {config.num_episodes} episodes, seeds {seeds[0]} to {seeds[-1]}, "
        f"policy after {contents['global_step']:,} steps"
    )
    print(describe_episodes(episodes))
    if config.json is not None:
        write_results(config, task, contents["global_step"], episodes)
    if config.card is not None:
        words = [word for word, before in zip(arguments, ["", *arguments], strict=False) if "--card" not in (word, before)]
        write_card(config.card, Path(config.checkpoint), contents, policy, words, episodes)
    if config.video is not None:
        print(f"video: {record_video(policy, task, seeds[:4], config.video)}")
    return episodes


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


def task_config(config: EvalConfig, trained: TrainConfig) -> TrainConfig:
    """Return the training options with the task replaced as asked for."""
    given = {pair.partition("=")[0] for pair in config.env_kwargs}
    kept = tuple(pair for pair in trained.env_kwargs if pair.partition("=")[0] not in given)
    return dataclasses.replace(
        trained,
        env_id=config.env_id or trained.env_id,
        env_kwargs=kept + config.env_kwargs,
        sim_backend=config.sim_backend or trained.sim_backend,
    )


def write_results(config: EvalConfig, task: TrainConfig, global_step: int, episodes: dict[str, torch.Tensor]) -> None:
    """Write means and per-episode values."""
    results = {
        "checkpoint": config.checkpoint,
        "env_id": task.env_id,
        "env_kwargs": task.env_options,
        "first_seed": config.seed,
        "num_episodes": config.num_episodes,
        "sigma": config.sigma,
        "global_step": global_step,
        "mean": {name: values.double().mean().item() for name, values in episodes.items()},
        "episodes": {name: values.tolist() for name, values in episodes.items()},
    }
    config.json.parent.mkdir(parents=True, exist_ok=True)
    config.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")


def main(arguments: Sequence[str]) -> int:
    """Evaluate; report what the user can mend in one line instead of a traceback."""
    try:
        evaluate(tyro.cli(EvalConfig, args=list(arguments), description=__doc__), arguments)
    except (ValueError, OSError, CheckpointError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
