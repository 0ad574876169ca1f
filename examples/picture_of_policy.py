"""Draw how a trained policy lays the rope: one row per episode, from start to end.

python examples/picture_of_policy.py --checkpoint checkpoints/rope_shaping_w.pt --picture docs/images/rope_shaping.png
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from PIL import Image

import maniskill_grpd  # noqa: F401  (registers the task)
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.checkpoints import load_policy

SEEDS = (2_000_000, 2_000_001, 2_000_002)
STEPS = (0, 8, 16, 24, 99)


def draw_episodes(checkpoint: Path) -> np.ndarray:
    """Play one episode per seed with mean actions and return the pictures side by side, (H, W, 3) uint8."""
    policy, contents = load_policy(checkpoint)
    options = TrainConfig.from_dict(contents["train_config"]).env_options
    env = gym.make("RopeShaping-v1", num_envs=len(SEEDS), render_mode="rgb_array", **options)
    obs, _ = env.reset(seed=list(SEEDS))
    columns = []
    for step in range(max(STEPS) + 1):
        if step in STEPS:
            columns.append(env.render().cpu().numpy())
        with torch.no_grad():
            obs = env.step(policy.act(obs["graph"], deterministic=True))[0]
    return np.concatenate([np.concatenate(list(column), axis=0) for column in columns], axis=1)


def main() -> None:
    """Parse the command line, play and write the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--checkpoint", type=Path, required=True, help="checkpoint of a policy for RopeShaping-v1")
    parser.add_argument("--picture", type=Path, required=True, help="file to write")
    arguments = parser.parse_args()
    arguments.picture.parent.mkdir(parents=True, exist_ok=True)
    picture = Image.fromarray(draw_episodes(arguments.checkpoint))
    picture.reduce(2).save(arguments.picture, optimize=True)


if __name__ == "__main__":
    main()
