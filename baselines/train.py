"""Train a policy on a deformable-object task.

python baselines/train.py --env_id RopeShaping-v1 --policy grpd --algorithm bpp --num_envs 64 \
    --total_timesteps 1_000_000 --seed 1

Everything goes to runs/{exp_name}/: config.json, metrics.jsonl, TensorBoard events, last.pt, best_ckpt.pt, final_ckpt.pt,
learning_curve.png and a video. A run that was stopped goes on with --resume runs/{exp_name}.

One process per core is the fast way on a CPU; num_envs is then shared among the processes:

torchrun --nproc_per_node=2 baselines/train.py --env_id RopeShaping-v1 --exp_name two_processes
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
import tyro
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv
from plot_learning_curve import plot_learning_curve
from record_video import record_video
from run_setup import make_run_name, make_vector_env, read_run_config, write_run_record

from maniskill_grpd.learning import CheckpointError, NonFiniteError, TrainConfig, Trainer
from maniskill_grpd.learning.allocator import keep_freed_memory
from maniskill_grpd.learning.workers import Workers, join_workers, leave_workers
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
    device = choose_device(config.sim_backend)
    workers = join_workers(device)
    run_dir = Path(config.resume) if config.resume else RUNS / workers.gather(make_run_name(config))[0]
    # The first process alone looks, or it might have written the file before the others do.
    is_taken = workers.gather((run_dir / "config.json").exists())[0]
    if not config.resume and is_taken:
        raise FileExistsError(f"{run_dir} already holds a run; continue it with --resume {run_dir} or choose another --exp_name")
    trainer = make_trainer(config, run_dir, workers)
    if config.resume:
        trainer.load(run_dir / "last.pt")
    elif config.checkpoint:
        trainer.load_weights(config.checkpoint)
    if workers.is_first:
        write_run_record(run_dir, config, trainer.envs.device, workers.size)
    trainer.train()
    if workers.is_first:
        finish(trainer)
    return run_dir


def choose_device(sim_backend: str) -> torch.device:
    """Return where this process computes; the processes of one machine each take a GPU of their own."""
    if sim_backend == "cpu" or not torch.cuda.is_available():
        return torch.device("cpu")
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
    torch.cuda.set_device(device)
    return device


def make_trainer(config: TrainConfig, run_dir: Path, workers: Workers | None = None) -> Trainer:
    """Make environments, an untrained policy and the trainer."""
    workers = workers or Workers()
    local = workers.share("num_envs", config.num_envs)
    envs = make_vector_env(config, local, partial_reset=config.partial_reset)
    eval_envs = None
    if config.eval_freq and workers.is_first:
        eval_envs = make_vector_env(config, config.num_eval_envs, partial_reset=False)
    torch.manual_seed(config.seed)
    options = fit_policy_options(config.policy_options, envs)
    policy = make_policy(config.policy, envs.unwrapped.graph_schema, **options).to(envs.device)
    size = sum(parameter.numel() for parameter in policy.parameters())
    if workers.is_first:
        print(
            f"{config.env_id}: {config.num_envs} environments on {envs.device} in {workers.size} process(es); policy "
            f"{config.policy} with {size:,} parameters; {config.algorithm}, {config.num_iterations} iterations of "
            f"{config.batch_size:,} steps; {run_dir}"
        )
    return Trainer(config, policy, envs, eval_envs, run_dir, workers)


def fit_policy_options(options: dict[str, Any], envs: ManiSkillVectorEnv) -> dict[str, Any]:
    """Give the policy a gripper output exactly where the task takes one.

    Raises:
        ValueError: If the options say otherwise.
    """
    has_grippers = envs.unwrapped.control_mode == "pd_ee_delta_pos_grip"
    if options.get("gripper", has_grippers) != has_grippers:
        takes = "opens and closes grippers" if has_grippers else "has fixed grasps"
        raise ValueError(
            f"policy_kwargs says gripper={json.dumps(options['gripper'])} but the task {takes}; leave it out, or "
            "choose with --env_kwargs grasp=free (or grasp=fixed)"
        )
    return {**options, "gripper": has_grippers} if has_grippers else options


def finish(trainer: Trainer) -> None:
    """Draw the learning curve and record the video of a trained policy."""
    print(f"learning curve: {plot_learning_curve(trainer.run_dir)}")
    if trainer.config.capture_video:
        seeds = range(FIRST_VIDEO_SEED, FIRST_VIDEO_SEED + NUM_VIDEO_EPISODES)
        path = trainer.run_dir / "videos" / "policy.mp4"
        print(f"video: {record_video(trainer.policy, trainer.config, seeds, path)}")


def parse_config(arguments: Sequence[str]) -> TrainConfig:
    """Parse the command line; with --resume the options of that run are the defaults.

    With --allow_import the id of that run's task may be of the form module:id, which runs the code of the module.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--resume", type=Path)
    resumed = finder.parse_known_args(arguments)[0].resume
    allow_import = "--allow_import" in arguments
    arguments = [word for word in arguments if word != "--allow_import"]
    default = TrainConfig() if resumed is None else read_run_config(resumed, allow_import=allow_import)
    return tyro.cli(TrainConfig, args=arguments, default=dataclasses.replace(default, resume=None), description=__doc__)


def main(arguments: Sequence[str]) -> int:
    """Train; report what the user can mend in one line instead of a traceback."""
    keep_freed_memory()
    try:
        run_dir = train(parse_config(arguments))
    except (ValueError, OSError, CheckpointError, NonFiniteError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; --resume continues the run from its last checkpoint", file=sys.stderr)
        return 130
    finally:
        leave_workers()
    print(f"done: python baselines/evaluate.py --checkpoint {run_dir / 'final_ckpt.pt'}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
