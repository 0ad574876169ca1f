"""Measure env-steps/s of RopeShaping-v1 beside a stock ManiSkill task, in one run.

python benchmarks/env.py [--quick] [--json FILE]

Ours steps through `ManiSkillVectorEnv` with graph observations and random actions. The peer is PickCube-v1 with state
observations on the same processor; PhysX on the CPU has one world per process. PickCube builds visuals and so needs a
Vulkan driver; where there is none, the peer is a minimal environment with one Panda and no visuals, and is labelled so.
Machines are noisy, so peer and ours take turns, and what counts is the ratio of medians.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import gymnasium as gym
import mani_skill.envs  # noqa: F401  (registers PickCube-v1)
import torch
from machine import describe_machine, report
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.registration import register_env
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

import maniskill_grpd  # noqa: F401  (registers RopeShaping-v1)

NUM_WORLDS = (1, 16, 64, 256)


@register_env("OnePanda-v0", max_episode_steps=50)
class OnePandaEnv(BaseEnv):
    """A Panda on nothing, without visuals: the least that a stock ManiSkill environment costs."""

    SUPPORTED_ROBOTS = ("panda",)

    def __init__(self, *args, **kwargs) -> None:
        super().__init__(*args, robot_uids="panda", **kwargs)

    def _load_scene(self, options: dict) -> None:
        pass

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict) -> None:
        pass

    def evaluate(self) -> dict:
        """Never succeed."""
        return {"success": torch.zeros(self.num_envs, dtype=torch.bool)}

    def compute_normalized_dense_reward(self, obs, action, info) -> torch.Tensor:
        """Pay nothing."""
        return torch.zeros(self.num_envs)


def make_peer() -> tuple[str, ManiSkillVectorEnv]:
    """Make PickCube-v1, or the minimal environment where no Vulkan driver is found."""
    try:
        env = gym.make("PickCube-v1", obs_mode="state", sim_backend="cpu", render_backend="none", num_envs=1)
        name = "PickCube-v1 (state)"
    except RuntimeError as error:
        if "rendering device" not in str(error):
            raise
        env = gym.make("OnePanda-v0", obs_mode="state", sim_backend="cpu", render_backend="none", num_envs=1)
        name = "one Panda without visuals (state; no Vulkan driver for PickCube-v1)"
    return name, ManiSkillVectorEnv(env, 1, record_metrics=True)


def make_ours(num_worlds: int) -> ManiSkillVectorEnv:
    """Make RopeShaping-v1 as a training script does, with all 41 nodes in the graph."""
    env = gym.make("RopeShaping-v1", num_envs=num_worlds, obs_mode="graph", sim_backend="cpu", graph_nodes=None)
    return ManiSkillVectorEnv(env, num_worlds, ignore_terminations=True, record_metrics=True)


def rate(env: ManiSkillVectorEnv, seconds: float) -> float:
    """Return env-steps/s over about `seconds` of random actions."""
    low, high = (torch.as_tensor(bound) for bound in (env.action_space.low, env.action_space.high))
    actions = [low + (high - low) * torch.rand(low.shape) for _ in range(16)]
    steps, start = 0, time.perf_counter()
    while time.perf_counter() - start < seconds:
        env.step(actions[steps % len(actions)])
        steps += 1
    return steps * env.num_envs / (time.perf_counter() - start)


def measure(seconds: float, repeats: int) -> list[dict]:
    """Return one row per environment, ours with the ratio to the peer."""
    peer_name, peer = make_peer()
    ours = {num: make_ours(num) for num in NUM_WORLDS}
    environments = {(peer_name, 1): peer, **{("RopeShaping-v1 (graph)", num): env for num, env in ours.items()}}
    for env in environments.values():
        env.reset(seed=0)
        rate(env, seconds / 4)  # warm-up: kernels compile and caches fill
    rates: dict[tuple[str, int], list[float]] = {key: [] for key in environments}
    for _ in range(repeats):
        for key, env in environments.items():
            rates[key].append(rate(env, seconds))
    peer_rate = statistics.median(rates[peer_name, 1])
    rows = []
    for (name, num), values in rates.items():
        row = {"env": name, "num_worlds": num, "env_steps_per_s": statistics.median(values)}
        row |= {"min": min(values), "max": max(values)}
        if name != peer_name:
            row |= {"peer": peer_name, "ratio": row["env_steps_per_s"] / peer_rate}
        rows.append(row)
    return rows


def main() -> None:
    """Parse the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="short measurements, for a look rather than for the record")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = measure(seconds=0.5 if arguments.quick else 3.0, repeats=2 if arguments.quick else 7)
    report(rows, describe_machine(), arguments.json)


if __name__ == "__main__":
    main()
