"""Train the toy policy in the processes that torchrun starts: run_workers.py RUN_DIR ITERATIONS [resume]."""

import dataclasses
import sys
from pathlib import Path

import torch
from run_toy import CONFIG
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import Trainer
from maniskill_grpd.learning.workers import join_workers, leave_workers

WORKERS_CONFIG = dataclasses.replace(CONFIG, num_minibatches=2, anneal_lr=False)


def main(run_dir: Path, iterations: int, resume: bool) -> None:
    """Train, and leave the weights of every process in a file of its own."""
    workers = join_workers("cpu")
    steps = iterations * WORKERS_CONFIG.batch_size
    trainer = Trainer(
        dataclasses.replace(WORKERS_CONFIG, total_timesteps=steps),
        ToyPolicy(seed=workers.rank),  # the weights of the first must win
        ToyEnv(workers.share("num_envs", WORKERS_CONFIG.num_envs), stagger=True),
        ToyEnv(WORKERS_CONFIG.num_eval_envs) if workers.is_first else None,
        run_dir,
        workers,
    )
    if resume:
        trainer.load(run_dir / "last.pt")
    trainer.train()
    torch.save(trainer.policy.state_dict(), run_dir / f"weights_{workers.rank}.pt")
    leave_workers()


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), "resume" in sys.argv)
