"""Print one hash per task and one per algorithm: equal numbers before and after a change that must not change behaviour.

python tools/fingerprint.py                  # all tasks, all algorithms, a minute or two
python tools/fingerprint.py --no-training    # trajectories alone

A task is hashed over 50 steps of 16 worlds with fixed seeds and actions: positions, rewards and graph observations. An algorithm
is hashed over the weights after a training of three iterations. Hashes are of bits: they are comparable on one machine and with
one set of library versions only.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.learning import load_checkpoint
from maniskill_grpd.runs.fingerprint import digest, hash_trajectories

ROOT = Path(__file__).parent.parent
TASKS = ("RopeShaping-v1", "RopeWrapping-v1", "ClothFolding-v1", "ClothHanging-v1")
NUM_WORLDS = 16
NUM_STEPS = 50
TRAININGS = {
    "bpp": ["--algorithm", "bpp"],
    "bpp lagrangian": ["--algorithm", "bpp", "--trust_region", "lagrangian"],
    "bpp fisher": ["--algorithm", "bpp", "--trust_region", "fisher"],
    "ppo": ["--algorithm", "ppo"],
}
TRAINING_FLAGS = [
    *("--num_envs", "16", "--num_steps", "20", "--num_minibatches", "4", "--total_timesteps", "960"),
    *("--eval_freq", "0", "--no-capture_video", "--seed", "3", "--sim_backend", "cpu"),
]


def hash_task(env_id: str) -> str:
    """Hash the trajectories of a task."""
    env = gym.make(env_id, num_envs=NUM_WORLDS, obs_mode="graph", sim_backend="cpu", num_threads=1)
    found = hash_trajectories(env, NUM_STEPS)
    env.close()
    return found


def hash_training(flags: list[str], env_id: str = "RopeShaping-v1") -> str:
    """Train three iterations in a process of its own and hash the weights."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / "baselines/train.py"), "--env_id", env_id, "--exp_name", "fingerprint"]
        subprocess.run([*command, *TRAINING_FLAGS, *flags], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        weights = load_checkpoint(Path(folder) / "runs/fingerprint/final_ckpt.pt")["weights"]
    return digest(weights.values())


def main() -> None:
    """Print all hashes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--no-training", action="store_true", help="trajectories alone")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    for env_id in TASKS:
        print(f"{env_id:<18}{hash_task(env_id)}", flush=True)
    if not arguments.no_training:
        for name, flags in TRAININGS.items():
            print(f"{name:<18}{hash_training(flags)}", flush=True)


if __name__ == "__main__":
    main()
