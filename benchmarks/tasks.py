"""Measure every task: what blind policies and the expert reach in it, and how fast it runs.

python benchmarks/tasks.py [--quick] [--json FILE]

Success and return are those of 200 episodes on seeds that nothing was tuned or trained on (20 with --quick). Blind policies are
"random" (a new random action at each step), "still" (no motion) and "push" (one random direction at full speed for the whole
episode). Speed is that of 64 worlds with graph observations and random actions on the CPU, tasks taking turns; what counts is the
ratio to RopeShaping-v1 in the same run.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch
from machine import describe_machine
from mani_skill.utils.registration import REGISTERED_ENVS
from tqdm import tqdm

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.experts import EXPERTS, make_expert
from maniskill_grpd.tasks import DeformableEnv

FIRST_SEED = 1_000_000
"""Experts are tuned, and policies trained, on other seeds."""
NUM_WORLDS = 64
REFERENCE = "RopeShaping-v1"
# What is measured beside the default configuration: options that change what has to be done.
CONFIGURATIONS: dict[str, tuple[dict[str, Any], ...]] = {
    "RopeShaping-v1": ({},),
    "RopeWrapping-v1": ({}, {"shapes": ("box", "prism")}),
    "ClothHanging-v1": ({}, {"hanger": "bar"}, {"release": True}),
    "ClothFolding-v1": ({}, {"num_grippers": 1}),
}


def task_ids() -> list[str]:
    """Return the ids of all tasks of the package."""
    return sorted(uid for uid, spec in REGISTERED_ENVS.items() if issubclass(spec.cls, DeformableEnv))


def make_env(env_id: str, num_worlds: int, **options: Any) -> gym.Env:
    """Make a task with graph observations on the CPU."""
    return gym.make(env_id, num_envs=num_worlds, obs_mode="graph", sim_backend="cpu", render_backend="none", **options)


def blind_policies(env: gym.Env, seed: int) -> dict[str, Callable[[], torch.Tensor]]:
    """Return policies that do not look at the worlds."""
    generator = torch.Generator().manual_seed(seed)
    num_worlds, width = env.action_space.shape
    per_gripper = width // env.unwrapped.num_grippers
    direction = torch.nn.functional.normalize(torch.randn(num_worlds, 1, 3, generator=generator), dim=-1)
    push = torch.zeros(num_worlds, env.unwrapped.num_grippers, per_gripper)
    push[..., :3] = direction
    push[..., 3:] = 1.0
    return {
        "random": lambda: torch.randn(num_worlds, width, generator=generator),
        "still": lambda: push.flatten(1) * (torch.arange(width) % per_gripper >= 3),
        "push": lambda: push.flatten(1),
    }


@torch.no_grad()
def play(env: gym.Env, act: Callable[[], torch.Tensor], seeds: list[int]) -> dict[str, float]:
    """Play one episode per seed; returns shares of success and the mean return."""
    num_worlds = env.unwrapped.num_envs
    once, at_end, returns = [], [], []
    for first in range(0, len(seeds), num_worlds):
        chunk = seeds[first : first + num_worlds]
        env.reset(seed=chunk + [chunk[-1]] * (num_worlds - len(chunk)))
        succeeded = torch.zeros(num_worlds, dtype=torch.bool)
        total, truncated = torch.zeros(num_worlds), torch.zeros(1, dtype=torch.bool)
        while not truncated.all():
            _, reward, _, truncated, info = env.step(act())
            succeeded |= info["success"]
            total += reward
        once.append(succeeded[: len(chunk)])
        at_end.append(info["success"][: len(chunk)])
        returns.append(total[: len(chunk)])
    return {
        "success_once": torch.cat(once).float().mean().item(),
        "success_at_end": torch.cat(at_end).float().mean().item(),
        "return": torch.cat(returns).mean().item(),
    }


def measure_policies(num_episodes: int) -> list[dict[str, Any]]:
    """Return one row per configuration of a task and policy."""
    seeds = list(range(FIRST_SEED, FIRST_SEED + num_episodes))
    rows = []
    cases = [(uid, options) for uid in task_ids() for options in CONFIGURATIONS.get(uid, ({},))]
    for uid, options in tqdm(cases, desc="policies", unit="task"):
        env = make_env(uid, min(50, num_episodes), **options)
        policies = blind_policies(env, seed=0)
        if uid in EXPERTS:
            policies["expert"] = make_expert(uid, env).act
        for name, act in policies.items():
            rows.append({"env": uid, "options": options, "policy": name, "num_episodes": num_episodes, **play(env, act, seeds)})
        env.close()
    return rows


def measure_speed(seconds: float, repeats: int) -> list[dict[str, Any]]:
    """Return one row per task: env-steps/s with all nodes in the graph, and the ratio to the reference task."""
    envs = {uid: make_env(uid, NUM_WORLDS, graph_nodes=None) for uid in task_ids()}
    actions = {uid: blind_policies(env, seed=0)["random"] for uid, env in envs.items()}
    rates: dict[str, list[float]] = {uid: [] for uid in envs}
    for round_ in tqdm(range(repeats + 1), desc="speed", unit="round"):
        for uid, env in envs.items():
            env.reset(seed=round_)
            steps, start = 0, time.perf_counter()
            while time.perf_counter() - start < seconds:
                env.step(actions[uid]())
                steps += 1
            if round_ > 0:  # the first round compiles kernels and fills caches
                rates[uid].append(steps * NUM_WORLDS / (time.perf_counter() - start))
    reference = statistics.median(rates[REFERENCE])
    rows = []
    for uid, values in rates.items():
        median = statistics.median(values)
        row = {"env": uid, "num_worlds": NUM_WORLDS, "env_steps_per_s": median, "min": min(values), "max": max(values)}
        rows.append({**row, "peer": REFERENCE, "ratio": median / reference})
    return rows


def main() -> None:
    """Parse the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="20 episodes and short measurements, for a look")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = measure_policies(20 if arguments.quick else 200)
    rows += measure_speed(0.5 if arguments.quick else 3.0, 2 if arguments.quick else 7)
    rows = [{**row, "machine": describe_machine()} for row in rows]
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(json.dumps([{key: row[key] for key in row if key != "machine"} for row in rows], indent=1) + "\n")


if __name__ == "__main__":
    main()
