"""Where policies for the W of RopeShaping-v1 fail: their trajectories beside the expert's.

python examples/rope_shaping_failures.py checkpoints/rope_shaping_w.pt [more checkpoints]

Every row plays the 200 seeds of `baselines/evaluate.py` with mean actions. *Up* is the direction from the lower vertices of
the W to its middle one: a rope that is dragged to its goal along -up trails with its middle on the right side.

- success: share of episodes that end in success, and the same by where the rope starts, seen from the goal: below (angle to
  up above 120 degrees), beside, above (below 60 degrees)
- beyond, lift: median over episodes of how far up and how high above their goals the grippers are at most, after they first
  came within 10 cm (mean over grippers) of them [cm]
- among episodes that fail, at their end: share with the middle on the right side (more than 5 cm up from the chord of the
  inner grippers), median distance of the grippers from their goals and of the middle vertex from its own [cm]
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the task)
from maniskill_grpd.experts import make_expert
from maniskill_grpd.runs.checkpoints import load_policy

NUM_WORLDS = 200
FIRST_SEED = 1_000_000
NUM_STEPS = 100
NEAR = 0.1
"""Mean distance of the grippers from their goals below which they have arrived [m]."""
RIGHT_SIDE = 0.05
"""Height of the middle over the chord of the inner grippers from which it counts as on the right side [m]; the goal's is 0.16."""
COLUMNS = (
    "player",
    "success",
    "from below",
    "from beside",
    "from above",
    "beyond",
    "lift",
    "failed: middle right",
    "grippers",
    "middle",
)


def play(env: gym.Env, act: Callable[[Any], torch.Tensor], first_obs: Any) -> list[float]:
    """Play one episode per world and return the figures of a row."""
    solver, goals = env.unwrapped.solver, env.unwrapped.goal_positions
    held = env.unwrapped.start_nodes
    quarter, middle = goals.shape[1] // 4, goals.shape[1] // 2
    gripper_goals = goals.gather(1, held[..., None].expand(-1, -1, 3))
    up = torch.nn.functional.normalize(_bulge(goals, quarter, middle), dim=-1)
    start = torch.nn.functional.normalize(solver.positions.mean(dim=1) - goals.mean(dim=1), dim=-1)
    side = (start * up).sum(dim=-1)

    has_arrived = torch.zeros(NUM_WORLDS, dtype=torch.bool)
    beyond, lift = torch.zeros(2, NUM_WORLDS)
    obs = first_obs
    for _ in range(NUM_STEPS):
        obs, _, _, _, info = env.step(act(obs))
        offsets = solver.gripper_positions - gripper_goals
        has_arrived |= offsets.norm(dim=-1).mean(dim=1) < NEAR
        along = (offsets * up[:, None]).sum(dim=-1).mean(dim=1)
        beyond = torch.where(has_arrived, torch.maximum(beyond, along), beyond)
        lift = torch.where(has_arrived, torch.maximum(lift, offsets[..., 2].mean(dim=1)), lift)

    success = info["success"]
    is_right = (_bulge(solver.positions, quarter, middle) * up).sum(dim=-1) > RIGHT_SIDE
    middle_distance = (solver.positions - goals)[:, middle].norm(dim=-1)
    gripper_distance = offsets.norm(dim=-1).mean(dim=1)
    shares = [success, success[side < -0.5], success[side.abs() <= 0.5], success[side > 0.5]]
    failed = ~success
    return [
        *(share.float().mean().item() for share in shares),
        100 * beyond.median().item(),
        100 * lift.median().item(),
        is_right[failed].float().mean().item(),
        100 * gripper_distance[failed].median().item() if failed.any() else float("nan"),
        100 * middle_distance[failed].median().item() if failed.any() else float("nan"),
    ]


def _bulge(nodes: torch.Tensor, quarter: int, middle: int) -> torch.Tensor:
    """Vectors from the middle between the inner grippers to the middle node, (B, 3) [m]."""
    return nodes[:, middle] - 0.5 * (nodes[:, quarter] + nodes[:, -1 - quarter])


def main(arguments: Sequence[str]) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoints", nargs="*", type=Path, help="policies for RopeShaping-v1 and its W, with four grippers")
    parser.add_argument("--graph_nodes", type=int, nargs="?", help="nodes the policies see, by default those of the task")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    settings = {} if options.graph_nodes is None else {"graph_nodes": options.graph_nodes}
    env = gym.make("RopeShaping-v1", num_envs=NUM_WORLDS, obs_mode="graph", sim_backend="cpu", **settings)
    seeds = list(range(FIRST_SEED, FIRST_SEED + NUM_WORLDS))
    print("|", " | ".join(COLUMNS), "|")
    print("|--|" + "--:|" * (len(COLUMNS) - 1))
    for path in options.checkpoints:
        policy, _ = load_policy(str(path))
        obs, _ = env.reset(seed=seeds)
        figures = play(env, lambda obs, policy=policy: policy.act(obs["graph"], deterministic=True), obs)
        print("|", path.stem, "|", *(f"{figure:.2f} |" for figure in figures))
    obs, _ = env.reset(seed=seeds)
    expert = make_expert("RopeShaping-v1", env)
    print("| expert |", *(f"{figure:.2f} |" for figure in play(env, lambda obs: expert.act(), obs)))


if __name__ == "__main__":
    main(sys.argv[1:])
