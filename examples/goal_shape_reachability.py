"""Which goal shapes of RopeShaping-v1 can be laid at all, by a planner that knows the reward alone.

python examples/goal_shape_reachability.py [--shapes S spiral] [--num_grippers 4] [--seeds 1000000] [--json FILE]

The planner is that of `maniskill-grpd plan`. A shape that it lays can be laid; one that it does not lay may still be, by another
search. Beside it stands the scripted expert, in 64 episodes. Rows that the file holds already are kept.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import torch

from maniskill_grpd.imitation.expert_actor import play_expert
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.planning import PlannerOptions
from maniskill_grpd.planning.episodes import make_planner, play_chunk
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.tasks import GOAL_SHAPES

EXPERT_EPISODES = 64


def make_task(shape: str, num_grippers: int) -> TrainConfig:
    """Name the task with a goal shape and a number of grippers."""
    options = (f"goal_shape={shape}", f"num_grippers={num_grippers}", "num_threads=1")
    return TrainConfig(env_id="RopeShaping-v1", env_kwargs=options, sim_backend="cpu")


def plan(shape: str, num_grippers: int, seeds: list[int], options: PlannerOptions) -> list[dict[str, Any]]:
    """Plan the episodes of some seeds at the same time; return a row for each: how it ended and what it took."""
    task = make_task(shape, num_grippers)
    env, planner = make_env(task, len(seeds)), make_planner(task, len(seeds), options)
    episodes = play_chunk(env, planner, seeds)
    env.close()
    planner.worlds.close()
    names = ("success_at_end", "success_once", "mean_distance", "max_distance", "plan_steps")
    known = {"shape": shape, "num_grippers": num_grippers}
    return [{**known, "seed": seed, **{name: episodes[name][row].item() for name in names}} for row, seed in enumerate(seeds)]


def main() -> None:
    """Plan what is asked for and not known yet, and print a row for each episode."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shapes", nargs="+", default=list(GOAL_SHAPES), choices=list(GOAL_SHAPES), help="goal shapes")
    parser.add_argument("--num_grippers", nargs="+", type=int, default=[4, 2], choices=[2, 3, 4], help="numbers of grippers")
    parser.add_argument("--seeds", nargs="+", type=int, default=[1_000_000], help="episodes to plan")
    parser.add_argument(
        "--samples", type=int, default=PlannerOptions.samples, help="plans that are tried at the same time for each episode"
    )
    parser.add_argument(
        "--iterations", type=int, default=PlannerOptions.iterations, help="times that plans are drawn before one is followed"
    )
    parser.add_argument("--horizon", type=int, default=PlannerOptions.horizon, help="steps that plans look ahead")
    parser.add_argument("--json", type=Path, help="file of the rows; those it holds are not planned again")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    options = PlannerOptions(samples=arguments.samples, iterations=arguments.iterations, horizon=arguments.horizon)
    rows = json.loads(arguments.json.read_text(encoding="utf-8")) if arguments.json and arguments.json.exists() else []
    known = {(row["shape"], row["num_grippers"], row["seed"]) for row in rows}
    for num_grippers in arguments.num_grippers:
        for shape in arguments.shapes:
            seeds = [seed for seed in arguments.seeds if (shape, num_grippers, seed) not in known]
            if not seeds:
                continue
            expert_seeds = range(min(arguments.seeds), min(arguments.seeds) + EXPERT_EPISODES)
            expert = play_expert(make_task(shape, num_grippers), expert_seeds, EXPERT_EPISODES)["success_at_end"]
            rows += [{**row, "expert": expert.float().mean().item()} for row in plan(shape, num_grippers, seeds, options)]
            print("\n".join(map(json.dumps, rows[-len(seeds) :])), flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
