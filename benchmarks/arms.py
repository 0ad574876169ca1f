"""What arms do beside floating grippers: success of experts and shipped policies on unseen seeds, and speed.

python benchmarks/arms.py [--quick] [--json FILE]

Success is that at the end of an episode; both kinds of grippers play the same seeds, but episodes that arms cannot reach are
drawn anew, and with arms ClothHanging-v1 has smaller ranges. Speeds are env-steps per second of processor time with graph
observations and random actions; floating grippers and arms take turns, and what counts is the median of the ratios of a turn.
Peers are PickCube-v1 and TwoRobotPickCube-v1 with state observations; where there is no Vulkan driver, which these need, as
many Pandas without visuals.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import sapien
import torch
from machine import describe_machine, report
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.registration import register_env

from maniskill_grpd.experts import make_expert
from maniskill_grpd.imitation.expert_actor import ExpertActor
from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.runs.play import change_task

CHECKPOINTS = Path(__file__).parent.parent / "checkpoints"
FIRST_SEED = 900_000
"""First of the seeds that are played; nothing was tuned on them."""
EXPERT_CASES = (
    ("RopeWrapping-v1", 2, ()),
    ("ClothFolding-v1", 2, ()),
    ("RopeShaping-v1", 4, ()),
    ("RopeShaping-v1", 2, ("goal_shape=L",)),
    ("ClothHanging-v1", 4, ("resolution=64",)),
    ("ClothHanging-v1", 3, ("resolution=64",)),
)
"""Task, grippers and options of the experts."""
POLICY_CASES = (("rope_wrapping", 2), ("rope_shaping_w", 4), ("cloth_folding", 2), ("cloth_hanging", 4))
"""Shipped policies and the grippers of their tasks."""
SPEED_CASES = ("RopeShaping-v1", "RopeWrapping-v1", "ClothFolding-v1")
NUM_WORLDS = (64, 1024)
LOST = 1e-3
"""Distance [m] that an arm misses in a step that counts as lost."""


def arm_options(num: int) -> tuple[str, ...]:
    """Return the option of so many Pandas."""
    return (f"robot_uids={json.dumps(['panda'] * num)}",)


class Losses:
    """Counts what arms lose while episodes are played: of their steps, those in which they miss, and in which they stand."""

    def __init__(self, env: gym.Env) -> None:
        self._arms = env.unwrapped.scene.arms
        self._lost: list[float] = []
        self._refused: list[float] = []

    def count(self) -> None:
        """Look at the step that was last taken."""
        if self._arms is not None:
            self._lost.append((self._arms.errors > LOST).float().mean().item())
            self._refused.append(self._arms.refused.float().mean().item())

    def shares(self) -> dict[str, float]:
        """Return the shares of all steps of all arms."""
        if self._arms is None:
            return {}
        return {"share_lost": statistics.fmean(self._lost), "share_refused": statistics.fmean(self._refused)}


def play_case(task: TrainConfig, policy: Any | None, num_episodes: int) -> dict[str, Any]:
    """Play a policy, or the expert of the task, on unseen seeds."""
    env = make_env(task, min(50, num_episodes))
    actor = ExpertActor(make_expert(task.env_id, env)) if policy is None else policy
    losses = Losses(env)
    episodes = evaluate_policy(actor, env, range(FIRST_SEED, FIRST_SEED + num_episodes), on_step=losses.count)
    found = {"success_at_end": episodes["success_at_end"].float().mean().item(), **losses.shares()}
    if env.unwrapped.scene.arms is not None:
        found["num_redrawn"] = env.unwrapped.num_redrawn.float().mean().item()
    env.close()
    return found


def measure_success(num_episodes: int) -> Iterator[dict[str, Any]]:
    """Yield one row per task and kind of grippers: what experts reach, then what shipped policies reach."""
    for env_id, num, options in EXPERT_CASES:
        for kind, own in (("floating", (f"num_grippers={num}",)), ("panda", arm_options(num))):
            task = TrainConfig(env_id=env_id, env_kwargs=(*options, *own), sim_backend="cpu")
            row = {"env": env_id, "options": list(options), "num": num, "actor": "expert", "grippers": kind}
            yield row | {"num_episodes": num_episodes} | play_case(task, None, num_episodes)
    for name, num in POLICY_CASES:
        policy, contents = load_policy(CHECKPOINTS / f"{name}.pt")
        trained = TrainConfig.from_dict(contents["train_config"])
        for kind, own in (("floating", ()), ("panda", arm_options(num))):
            task = change_task(trained, None, own, "cpu")
            row = {"env": task.env_id, "options": [], "num": num, "actor": f"{name}.pt", "grippers": kind}
            yield row | {"num_episodes": num_episodes} | play_case(task, policy, num_episodes)


def rate(env: gym.Env, seconds: float) -> float:
    """Return env-steps per second of processor time over about `seconds` of random actions."""
    num_worlds = env.unwrapped.num_envs
    actions = 2.0 * torch.rand(16, num_worlds, env.action_space.shape[-1]) - 1.0
    steps, start = 0, time.process_time()
    while time.process_time() - start < seconds:
        env.step(actions[steps % len(actions)])
        steps += 1
    return steps * num_worlds / (time.process_time() - start)


def measure_speed(seconds: float, repeats: int) -> Iterator[dict[str, Any]]:
    """Yield one row per task, number of worlds and kind of grippers; that of arms has the ratio."""
    for env_id in SPEED_CASES:
        for num_worlds in NUM_WORLDS:
            envs = {
                kind: make_env(TrainConfig(env_id=env_id, env_kwargs=own, sim_backend="cpu"), num_worlds, num_threads=1)
                for kind, own in (("floating", ("num_grippers=2",)), ("panda", arm_options(2)))
            }
            for env in envs.values():
                env.reset(seed=0)
                rate(env, seconds / 4)
            turns = [{kind: rate(env, seconds) for kind, env in envs.items()} for _ in range(repeats)]
            for kind, env in envs.items():
                env.close()
                row = {"env": env_id, "num_worlds": num_worlds, "grippers": kind}
                row["env_steps_per_s"] = statistics.median(turn[kind] for turn in turns)
                if kind == "panda":
                    row["ratio"] = statistics.median(turn["panda"] / turn["floating"] for turn in turns)
                yield row


@register_env("PandasAlone-v0", max_episode_steps=50)
class PandasAloneEnv(BaseEnv):
    """Pandas on nothing, without visuals: the least that a stock ManiSkill environment with as many arms costs."""

    SUPPORTED_ROBOTS = ("panda", ("panda", "panda"))

    def _load_agent(self, options: dict) -> None:
        poses = [sapien.Pose([0.0, float(index), 0.0]) for index in range(2)]
        super()._load_agent(options, poses if isinstance(self.robot_uids, tuple) else poses[0])

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


def measure_peers(seconds: float, repeats: int) -> Iterator[dict[str, Any]]:
    """Yield one row per task of ManiSkill."""
    for env_id, robots in (("PickCube-v1", "panda"), ("TwoRobotPickCube-v1", ("panda", "panda"))):
        settings = {"obs_mode": "state", "sim_backend": "cpu", "render_backend": "none", "num_envs": 1}
        try:
            env, name = gym.make(env_id, **settings), env_id
        except RuntimeError as error:
            if "rendering device" not in str(error):
                raise
            env = gym.make("PandasAlone-v0", robot_uids=robots, **settings)
            name = f"Pandas without visuals, as many as {env_id} has (no Vulkan driver for it)"
        env.reset(seed=0)
        sampled_rate(env, seconds / 4)
        rates = [sampled_rate(env, seconds) for _ in range(repeats)]
        env.close()
        yield {"env": name, "num_worlds": 1, "env_steps_per_s": statistics.median(rates)}


def sampled_rate(env: gym.Env, seconds: float) -> float:
    """Return env-steps per second of processor time of a single world, of one agent or several."""
    actions = [env.action_space.sample() for _ in range(16)]
    steps, start = 0, time.process_time()
    while time.process_time() - start < seconds:
        env.step(actions[steps % len(actions)])
        steps += 1
    return steps / (time.process_time() - start)


def main() -> None:
    """Parse the command line, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="20 episodes and short measurements, for a look")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    seconds, repeats = (0.5, 2) if arguments.quick else (2.0, 5)
    rows = []
    parts = (measure_success(20 if arguments.quick else 200), measure_speed(seconds, repeats), measure_peers(seconds, repeats))
    for part in parts:
        for row in part:
            rows.append(row)
            print(row, flush=True)  # noqa: T201 (hours may lie between rows)
    report(rows, describe_machine(), arguments.json)


if __name__ == "__main__":
    main()
