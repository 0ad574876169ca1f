"""A short training run of the toy policy on the toy task."""

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


def make_toy_trainer(run_dir, config=CONFIG):
    """Make a trainer on the toy task, always with the same initial weights."""
    return Trainer(
        config, ToyPolicy(seed=config.seed), ToyEnv(config.num_envs, stagger=True), ToyEnv(config.num_eval_envs), run_dir
    )
