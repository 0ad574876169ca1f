"""Which goal shapes of RopeShaping-v1 can be laid at all, by an optimiser that plays the same episode over and over.

python examples/goal_shape_reachability.py [--shapes S spiral] [--num_grippers 4] [--seeds 1000000] [--json FILE]

Every gripper follows straight lines between waypoints that lie open to choice, the last of them near the goal of the node it
holds. The cross-entropy method (Rubinstein 1999) draws plans from a normal distribution, plays each in a world of its own, and
fits the distribution to the best of them. A shape that an open plan lays is solvable; one that none lays may still be, by
feedback or a better search. Beside it stands the scripted expert, in 64 episodes. Rows that the file holds already are kept.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the task)
from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts import make_expert
from maniskill_grpd.tasks import GOAL_SHAPES

NUM_STEPS = 100
NUM_WAYPOINTS = 7
STEPS_PER_WAYPOINT = 13
"""The rest of the episode is for the rope to come to rest."""
NUM_ELITES = 20
SPREAD = (0.12, 0.12, 0.06)
"""Standard deviations with which waypoints are first drawn [m]."""
LAST_SPREAD = 0.02
"""That of the last ones [m]."""
SMALLEST_SPREAD = 0.003
"""Distributions do not become narrower than this [m]."""
WIDENING = 0.3
"""Share of its last spread that a distribution keeps."""
EXPERT_EPISODES = 64


def play_plans(env: gym.Env, seed: int, plans: torch.Tensor) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Play one plan in each world, all from the same episode.

    Args:
        env: RopeShaping-v1 with B worlds.
        seed: Seed of the episode.
        plans: Waypoints relative to the goals of what the grippers hold, (B, K, A, 3) [m].

    Returns:
        costs: Mean distance of the nodes from their goals, and by how much the largest exceeds what is allowed, (B,) [m].
        info: The last one of the episode.
    """
    task = env.unwrapped
    env.reset(seed=[seed] * task.num_envs)
    held = task.start_nodes[..., None].expand(-1, -1, 3)
    goals = task.goal_positions.gather(1, held)
    points = torch.cat([task.solver.gripper_positions[:, None], goals[:, None] + plans], dim=1)
    points[..., 2] = torch.maximum(points[..., 2], goals[:, None, :, 2])
    for step in range(1, NUM_STEPS + 1):
        index, share = divmod(min(step, NUM_WAYPOINTS * STEPS_PER_WAYPOINT - 1), STEPS_PER_WAYPOINT)
        target = torch.lerp(points[:, index], points[:, index + 1], (share + 1) / STEPS_PER_WAYPOINT)
        motion = (target - task.solver.gripper_positions) / STEP_SIZE
        *_, info = env.step((motion / motion.norm(dim=-1, keepdim=True).clamp(min=1.0)).flatten(1))
    return info["mean_distance"] + (info["max_distance"] - task.MAX_DISTANCE_LIMIT).clamp(min=0.0), info


def search(env: gym.Env, seed: int, num_iterations: int) -> dict[str, Any]:
    """Search a plan for an episode; return whether it succeeds and how near it comes [m], and the plays it took."""
    num_worlds, num_grippers = env.unwrapped.num_envs, env.unwrapped.num_grippers
    generator = torch.Generator().manual_seed(seed)
    mean = torch.zeros(NUM_WAYPOINTS, num_grippers, 3)
    spread = torch.tensor(SPREAD).expand_as(mean).clone()
    spread[-1] = LAST_SPREAD
    best, lowest, found, num_plays = mean, torch.inf, {}, 0
    for _ in range(num_iterations):
        num_plays += num_worlds
        plans = mean + spread * torch.randn(num_worlds, *mean.shape, generator=generator)
        plans[0] = best
        costs, info = play_plans(env, seed, plans)
        elites = plans[costs.argsort()[:NUM_ELITES]]
        if costs.min() < lowest:
            winner = int(costs.argmin())
            lowest, best = float(costs[winner]), plans[winner]
            found = {name: float(info[name][winner]) for name in ("success", "mean_distance", "max_distance")}
        if found["success"]:
            break
        mean = elites.mean(dim=0)
        spread = (WIDENING * spread + (1.0 - WIDENING) * elites.std(dim=0)).clamp(min=SMALLEST_SPREAD)
    return {**found, "plays": num_plays}


def play_expert(shape: str, num_grippers: int, first_seed: int) -> float:
    """Return the share of episodes that the expert ends in success."""
    env = _make(shape, num_grippers, EXPERT_EPISODES)
    env.reset(seed=list(range(first_seed, first_seed + EXPERT_EPISODES)))
    expert = make_expert("RopeShaping-v1", env)
    for _ in range(NUM_STEPS):
        *_, info = env.step(expert.act())
    env.close()
    return float(info["success"].float().mean())


def _make(shape: str, num_grippers: int, num_worlds: int) -> gym.Env:
    options = {"goal_shape": shape, "num_grippers": num_grippers, "num_threads": 1}
    return gym.make("RopeShaping-v1", num_envs=num_worlds, obs_mode="none", sim_backend="cpu", render_backend="none", **options)


def main() -> None:
    """Search what is asked for and not found yet, and print a row for each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", default=list(GOAL_SHAPES), choices=list(GOAL_SHAPES), help="goal shapes")
    parser.add_argument("--num_grippers", nargs="+", type=int, default=[4, 2], choices=[2, 3, 4], help="numbers of grippers")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1_000_000], help="episodes to search plans for")
    parser.add_argument("--num_worlds", type=int, default=192, help="plans in each iteration")
    parser.add_argument("--num_iterations", type=int, default=25, help="iterations before a search is given up")
    parser.add_argument("--json", type=Path, help="file of the rows; those it holds are not searched again")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = json.loads(arguments.json.read_text(encoding="utf-8")) if arguments.json and arguments.json.exists() else []
    known = {(row["shape"], row["num_grippers"], row["seed"]) for row in rows}
    wanted = [(shape, num, seed) for num in arguments.num_grippers for shape in arguments.shapes for seed in arguments.seeds]
    for shape, num_grippers, seed in [case for case in wanted if case not in known]:
        env = _make(shape, num_grippers, arguments.num_worlds)
        row = {"shape": shape, "num_grippers": num_grippers, "seed": seed, **search(env, seed, arguments.num_iterations)}
        env.close()
        rows.append({**row, "expert": play_expert(shape, num_grippers, min(arguments.seeds))})
        print(json.dumps(rows[-1]), flush=True)
        if arguments.json:
            arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
