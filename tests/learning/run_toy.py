"""Train the toy policy in a process of its own: run_toy.py RUN_DIR [KILL_AT_STEP]."""

import os
import signal
import sys
from pathlib import Path

from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import TrainConfig, Trainer

CONFIG = TrainConfig(
    num_envs=8,
    num_eval_envs=4,
    num_steps=7,  # episodes of 10 steps: checkpoints fall in the middle of episodes
    num_minibatches=4,
    update_epochs=2,
    total_timesteps=8 * 7 * 9,
    checkpoint_freq=3,
    eval_freq=2,
    anneal_lr=True,
)


class MortalEnv(ToyEnv):
    """Kills its process at a given step, as an out-of-memory killer or a power cut would."""

    def __init__(self, num_envs, kill_at):
        super().__init__(num_envs, stagger=True)
        self.kill_at = kill_at

    def step(self, action):
        """Step or die."""
        if self.total_steps == self.kill_at:
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(action)


def make_toy_trainer(run_dir, config=CONFIG, kill_at=-1):
    """Make a trainer on the toy task, always with the same initial weights."""
    return Trainer(
        config,
        ToyPolicy(seed=config.seed),
        MortalEnv(config.num_envs, kill_at),
        ToyEnv(config.num_eval_envs),
        run_dir,
    )


if __name__ == "__main__":
    make_toy_trainer(Path(sys.argv[1]), kill_at=int(sys.argv[2])).train()
