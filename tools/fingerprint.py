"""Print one hash per task and one per algorithm: equal numbers before and after a change that must not change behaviour.

python tools/fingerprint.py                  # all tasks, all algorithms, a minute or two
python tools/fingerprint.py --no-training    # trajectories alone

A task is hashed over 50 steps of 16 worlds with fixed seeds and actions: positions, rewards and graph observations. An algorithm
is hashed over the weights after a training of three iterations. Hashes are of bits: they are comparable on one machine and with
one set of library versions only.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.learning import load_checkpoint

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


def tensors(value: Any) -> Iterator[torch.Tensor]:
    """Yield the tensors of a nested dictionary in the order of their names."""
    if isinstance(value, dict):
        for key in sorted(value):
            yield from tensors(value[key])
    elif isinstance(value, torch.Tensor):
        yield value


def digest(values: Iterator[torch.Tensor]) -> str:
    """Return the first 16 digits of the SHA-256 of tensors, bit by bit."""
    total = hashlib.sha256()
    for value in values:
        total.update(value.detach().cpu().contiguous().numpy().tobytes())
    return total.hexdigest()[:16]


def hash_task(env_id: str) -> str:
    """Step a task with fixed seeds and actions and hash what it returns."""
    env = gym.make(env_id, num_envs=NUM_WORLDS, obs_mode="graph", sim_backend="cpu", num_threads=1)
    generator = torch.Generator().manual_seed(7)
    seen: list[torch.Tensor] = []
    obs, _ = env.reset(seed=11)
    seen += tensors(obs)
    size = env.unwrapped.single_action_space.shape[0]
    for _ in range(NUM_STEPS):
        action = 2.0 * torch.rand(NUM_WORLDS, size, generator=generator) - 1.0
        obs, reward, *_ = env.step(action)
        seen += [*tensors(obs), reward, env.unwrapped.solver.positions.clone()]
    env.close()
    return digest(iter(seen))


def hash_training(flags: list[str], env_id: str = "RopeShaping-v1") -> str:
    """Train three iterations in a process of its own and hash the weights."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, str(ROOT / "baselines/train.py"), "--env_id", env_id, "--exp_name", "fingerprint"]
        subprocess.run([*command, *TRAINING_FLAGS, *flags], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        weights = load_checkpoint(Path(folder) / "runs/fingerprint/final_ckpt.pt")["weights"]
    return digest(iter(weights.values()))


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
