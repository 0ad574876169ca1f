"""Success and cost per episode of planning, beside the expert and the policy of each task.

python benchmarks/planner.py [--tasks ID ...] [--agents NAME ...] [--episodes N] --json docs/benchmarks/planner.json

Agents are "expert", "policy" (the checkpoint of the task), "cem" and "mppi" (plans from nothing) and "prior" (plans from the
policy). Episodes are those of the first seeds of `evaluate`. Cost is processor seconds and steps of the environment per episode;
wall-clock seconds are longer where other programs run. Rows that the file holds already are kept.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import subprocess
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from machine import describe_machine

from maniskill_grpd.imitation.expert_actor import play_expert
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.planning import PlannerOptions
from maniskill_grpd.planning.episodes import PlanConfig, plan_episodes
from maniskill_grpd.runs.evaluation import EvaluationConfig, evaluate
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED

CHECKPOINTS = {
    "RopeShaping-v1": "checkpoints/rope_shaping_w.pt",
    "RopeWrapping-v1": "checkpoints/rope_wrapping.pt",
    "ClothHanging-v1": "checkpoints/cloth_hanging.pt",
    "ClothFolding-v1": "checkpoints/cloth_folding.pt",
}
AGENTS = ("expert", "policy", "cem", "mppi", "prior")
EPISODES = {"RopeShaping-v1": 8, "RopeWrapping-v1": 4, "ClothHanging-v1": 4, "ClothFolding-v1": 2}
"""Episodes that are planned; expert and policy play `PLAYED` ones, which cost nothing."""
PLAYED = 100
SETTINGS: dict[str, dict[str, Any]] = {
    "RopeShaping-v1": {},
    "RopeWrapping-v1": {"samples": 32},
    "ClothHanging-v1": {"samples": 32, "iterations": 2, "first_iterations": 4},
    "ClothFolding-v1": {
        "env_kwargs": ("resolution=49",),
        "horizon": 30,
        "noise_exponent": 3.0,
        "first_iterations": 15,
        "iterations": 2,
        "replan": 10,
    },
}
"""What differs from the defaults of `plan`: as much as some seconds for a rope, or a minute for a cloth, pay for."""
PRIOR_SETTINGS = {"samples": 32, "iterations": 1, "first_iterations": 1, "std": 0.2}


def measure(env_id: str, agent: str, num_episodes: int) -> dict[str, Any]:
    """Play the episodes of an agent in a task; return what came of it and what it cost."""
    seeds = range(FIRST_TEST_SEED, FIRST_TEST_SEED + num_episodes)
    start, seconds = time.perf_counter(), time.process_time()
    options: Mapping[str, Any] = {}
    task_options: dict[str, Any] = {}
    checkpoint = Path(CHECKPOINTS[env_id])
    if agent == "expert":
        episodes = play_expert(TrainConfig(env_id=env_id, sim_backend="cpu"), seeds, 50)
    elif agent == "policy":
        settings = {"num_episodes": num_episodes, "num_envs": 50, "sim_backend": "cpu"}
        episodes = evaluate(EvaluationConfig(checkpoint=checkpoint, **settings)).episodes
    else:
        options = PRIOR_SETTINGS if agent == "prior" else {**SETTINGS[env_id], "method": agent}
        task = {"checkpoint": checkpoint} if agent == "prior" else {"env_id": env_id}
        config = PlanConfig(num_episodes=num_episodes, num_envs=4, sim_backend="cpu", **task, **options)
        options = {field.name: getattr(config, field.name) for field in dataclasses.fields(PlannerOptions)}
        planned = plan_episodes(config)
        episodes, task_options = planned.episodes, planned.task.env_options
    return {
        "env": env_id,
        "agent": agent,
        "num_episodes": num_episodes,
        "success_at_end": episodes["success_at_end"].float().mean().item(),
        "return": episodes["return"].mean().item(),
        "steps": (episodes["episode_len"] + episodes.get("plan_steps", torch.zeros(()))).mean().item(),
        "cpu_seconds": (time.process_time() - seconds) / num_episodes,
        "wall_seconds": (time.perf_counter() - start) / num_episodes,
        "planner": options,
        "commit": _commit(),
        "env_kwargs": task_options,
        "machine": describe_machine(),
    }


def default_episodes(env_id: str, agent: str) -> int:
    """Return how many episodes of an agent the page has."""
    return PLAYED if agent in ("expert", "policy") else EPISODES[env_id]


def _commit() -> str:
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short=10", "HEAD"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def main() -> None:
    """Measure what the file does not hold yet."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", default=list(CHECKPOINTS), choices=list(CHECKPOINTS), help="tasks to play")
    parser.add_argument("--agents", nargs="+", default=list(AGENTS), choices=AGENTS, help="agents to play them with")
    parser.add_argument("--episodes", type=int, help="episodes of each; by default what the rows of the page have")
    parser.add_argument("--json", type=Path, required=True, help="file of the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = json.loads(arguments.json.read_text(encoding="utf-8")) if arguments.json.exists() else []
    known = {(row["env"], row["agent"]) for row in rows}
    for case in itertools.product(arguments.tasks, arguments.agents):
        if case not in known:
            rows.append(measure(*case, arguments.episodes or default_episodes(*case)))
            print(json.dumps(rows[-1]), flush=True)
            arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
