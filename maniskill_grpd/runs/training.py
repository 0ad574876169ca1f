"""Train as configured: environments, policy, trainer, record, pictures."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

import torch

from maniskill_grpd.learning import TrainConfig, Trainer
from maniskill_grpd.learning.stopping import never
from maniskill_grpd.learning.workers import Workers, join_workers
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.environments import check_task, make_vector_env
from maniskill_grpd.runs.fingerprint import describe_training
from maniskill_grpd.runs.folder import RUNS, hold_run
from maniskill_grpd.runs.learning_curve import plot_learning_curve
from maniskill_grpd.runs.policy_options import fit_policy_options
from maniskill_grpd.runs.recommended import describe_settings
from maniskill_grpd.runs.record import make_run_name, write_run_record
from maniskill_grpd.runs.seeds import FIRST_VIDEO_SEED
from maniskill_grpd.runs.video import record_video

NUM_VIDEO_EPISODES = 4
CLONED_STD = 0.05
"""Standard deviation with which a policy that clones demonstrations explores, in units of the largest action."""

WarmStart = Callable[[Trainer], None]
"""Teaches the policy of a trainer before its first step."""


def train(config: TrainConfig, should_stop: Callable[[], bool] = never, warm_start: WarmStart | None = None) -> Path:
    """Run a training as configured.

    Args:
        config: Options; with `resume` those of the run that goes on.
        should_stop: Asked after each iteration whether to stop there.
        warm_start: Teaches the policy first, unless the run goes on from a checkpoint.

    Returns:
        The folder of the run.

    Raises:
        FileExistsError: If the folder already holds a run that is not to be resumed.
        RunInUseError: If another process works at it.
        TrainingStoppedError: If it was asked to stop before the last iteration.
    """
    check_task(config.env_id, config.env_options)
    device = choose_device(config.sim_backend)
    workers = join_workers(device)
    run_dir = Path(config.resume) if config.resume else RUNS / workers.gather(make_run_name(config))[0]
    # The first process alone looks, or it might have written the file before the others do.
    is_taken = workers.gather((run_dir / "config.json").exists())[0]
    if not config.resume and is_taken:
        raise FileExistsError(f"{run_dir} already holds a run; continue it with --resume {run_dir} or choose another --exp_name")
    with hold_run(run_dir) if workers.is_first else contextlib.nullcontext():
        _train_in(run_dir, config, workers, should_stop, warm_start)
    return run_dir


def _train_in(
    run_dir: Path, config: TrainConfig, workers: Workers, should_stop: Callable[[], bool], warm_start: WarmStart | None
) -> None:
    """Train in a folder that no other process works at."""
    trainer = make_trainer(config, run_dir, workers, should_stop)
    # A run that was stopped before its first checkpoint begins anew.
    has_checkpoint = workers.gather((run_dir / "last.pt").exists())[0]
    if config.resume and has_checkpoint:
        trainer.load(run_dir / "last.pt")
    elif config.checkpoint:
        trainer.load_weights(config.checkpoint)
    elif warm_start is not None:
        warm_start(trainer)
    if workers.is_first:
        write_run_record(run_dir, config, trainer.envs.device, describe_training(config), workers.size)
    trainer.train()
    if workers.is_first:
        finish(trainer)


def choose_device(sim_backend: str) -> torch.device:
    """Return where this process computes; the processes of one machine each take a GPU of their own."""
    if sim_backend == "cpu" or not torch.cuda.is_available():
        return torch.device("cpu")
    device = torch.device("cuda", int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
    torch.cuda.set_device(device)
    return device


def make_trainer(
    config: TrainConfig, run_dir: Path, workers: Workers | None = None, should_stop: Callable[[], bool] = never
) -> Trainer:
    """Make environments, an untrained policy and the trainer."""
    workers = workers or Workers()
    local = workers.share("num_envs", config.num_envs)
    for_critic = {} if config.critic_observations == "same" else {"critic_observations": config.critic_observations}
    envs = make_vector_env(config, local, partial_reset=config.partial_reset, **for_critic)
    eval_envs = None
    if config.eval_freq and workers.is_first:
        eval_envs = make_vector_env(config, config.num_eval_envs, partial_reset=False)
    torch.manual_seed(config.seed)
    cloned = {"init_std": CLONED_STD} if config.demonstrations else {}
    options = fit_policy_options(cloned | config.policy_options, envs)
    policy = make_policy(config.policy, envs.unwrapped.graph_schema, **options).to(envs.device)
    size = sum(parameter.numel() for parameter in policy.parameters())
    if workers.is_first:
        print(describe_settings(config))
        print(
            f"{config.env_id}: {config.num_envs} environments on {envs.device} in {workers.size} process(es); policy "
            f"{config.policy} with {size:,} parameters; {config.algorithm}, {config.num_iterations} iterations of "
            f"{config.batch_size:,} steps; {run_dir}"
        )
    return Trainer(config, policy, envs, eval_envs, run_dir, workers, should_stop)


def finish(trainer: Trainer) -> None:
    """Draw the learning curve and record the video of a trained policy."""
    print(f"learning curve: {plot_learning_curve(trainer.run_dir)}")
    if trainer.config.capture_video:
        seeds = range(FIRST_VIDEO_SEED, FIRST_VIDEO_SEED + NUM_VIDEO_EPISODES)
        path = trainer.run_dir / "videos" / "policy.mp4"
        print(f"video: {record_video(trainer.policy, trainer.config, seeds, path)}")
