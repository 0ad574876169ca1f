"""Train a policy on a deformable-object task.

python baselines/train.py --env_id RopeShaping-v1 --policy grpd --algorithm bpp --num_envs 64 \
    --total_timesteps 1_000_000 --seed 1

Everything goes to runs/{exp_name}/: config.json, metrics.jsonl, TensorBoard events, last.pt, best_ckpt.pt, final_ckpt.pt,
learning_curve.png and a video. A run that was stopped goes on with --resume runs/{exp_name}.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import torch
import tyro
from plot_learning_curve import plot_learning_curve
from record_video import record_video
from run_setup import make_run_name, make_vector_env, read_run_config, write_run_record

from maniskill_grpd.learning import CheckpointError, NonFiniteError, TrainConfig, Trainer
from maniskill_grpd.policies import make_policy

RUNS = Path("runs")

FIRST_VIDEO_SEED = 2_000_000
"""Videos show seeds that neither training nor evaluation uses."""

NUM_VIDEO_EPISODES = 4


def train(config: TrainConfig) -> Path:
    """Run a training as configured.

    Args:
        config: Options; with `resume` those of the run that goes on.

    Returns:
        The folder of the run.

    Raises:
        FileExistsError: If the folder already holds a run that is not to be resumed.
    """
    run_dir = Path(config.resume) if config.resume else RUNS / make_run_name(config)
    if not config.resume and (run_dir / "config.json").exists():
        raise FileExistsError(
            f"{run_dir} already holds a run; continue it with --resume {run_dir} or choose another --exp_name"
        )
    trainer = make_trainer(config, run_dir)
    if config.resume:
        trainer.load(run_dir / "last.pt")
    elif config.checkpoint:
        trainer.load_weights(config.checkpoint)
    write_run_record(run_dir, config, trainer.envs.device)
    trainer.train()
    finish(trainer)
    return run_dir


def make_trainer(config: TrainConfig, run_dir: Path) -> Trainer:
    """Make environments, an untrained policy and the trainer."""
    envs = make_vector_env(config, config.num_envs, partial_reset=config.partial_reset)
    eval_envs = (
        make_vector_env(config, config.num_eval_envs, partial_reset=False)
        if config.eval_freq
        else None
    )
    torch.manual_seed(config.seed)
    policy = make_policy(config.policy, envs.unwrapped.graph_schema, **config.policy_options).to(
        envs.device
    )
    size = sum(parameter.numel() for parameter in policy.parameters())
    print(
        f"{config.env_id}: {config.num_envs} environments on {envs.device}; policy {config.policy} with {size:,} "
        f"parameters; {config.algorithm}, {config.num_iterations} iterations of {config.batch_size:,} steps; {run_dir}"
    )
    return Trainer(config, policy, envs, eval_envs, run_dir)


def finish(trainer: Trainer) -> None:
    """Draw the learning curve and record the video of a trained policy."""
    print(f"learning curve: {plot_learning_curve(trainer.run_dir)}")
    if trainer.config.capture_video:
        seeds = range(FIRST_VIDEO_SEED, FIRST_VIDEO_SEED + NUM_VIDEO_EPISODES)
        path = trainer.run_dir / "videos" / "policy.mp4"
        print(f"video: {record_video(trainer.policy, trainer.config, seeds, path)}")


def parse_config(arguments: Sequence[str]) -> TrainConfig:
    """Parse the command line; with --resume the options of that run are the defaults."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--resume", type=Path)
    resumed = finder.parse_known_args(arguments)[0].resume
    default = TrainConfig() if resumed is None else read_run_config(resumed)
    return tyro.cli(
        TrainConfig,
        args=list(arguments),
        default=dataclasses.replace(default, resume=None),
        description=__doc__,
    )


def main(arguments: Sequence[str]) -> int:
    """Train; report what the user can mend in one line instead of a traceback."""
    try:
        run_dir = train(parse_config(arguments))
    except (ValueError, OSError, CheckpointError, NonFiniteError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; --resume continues the run from its last checkpoint", file=sys.stderr)
        return 130
    print(f"done: python baselines/evaluate.py --checkpoint {run_dir / 'final_ckpt.pt'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
