"""Play experts with objects that collide with themselves; count successes and crossings.

python -m benchmarks.self_contact [--episodes N] [--json FILE]

A row for each task and configuration: shares of success (once, at the end), episodes in which a cloth passed through itself in
any step and at the end (edges through triangles, `physics.crossings`; a rope has none), and the most contacts that found no room.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.experts import make_expert

FIRST_SEED = 1_000_000
"""Experts are tuned on other seeds."""
CONFIGURATIONS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("RopeShaping-v1", {}),
    ("RopeWrapping-v1", {}),
    ("ClothHanging-v1", {}),
    ("ClothHanging-v1", {"hanger": "bar"}),
    ("ClothHanging-v1", {"release": True}),
    ("ClothFolding-v1", {}),
    ("ClothFolding-v1", {"num_grippers": 1}),
)


@torch.no_grad()
def play(env_id: str, options: dict[str, Any], num_episodes: int) -> dict[str, Any]:
    """Play one episode of the expert per seed, all at once."""
    is_cloth = env_id.startswith("Cloth")
    settings = {"obs_mode": "graph", "sim_backend": "cpu", "render_backend": "none", "count_crossings": is_cloth}
    env = gym.make(env_id, num_envs=num_episodes, **settings, **options)
    expert = make_expert(env_id, env)
    env.reset(seed=list(range(FIRST_SEED, FIRST_SEED + num_episodes)))
    succeeded = crossed = torch.zeros(num_episodes, dtype=torch.bool)
    truncated = torch.zeros(1, dtype=torch.bool)
    while not truncated.all():
        _, _, _, truncated, info = env.step(expert.act())
        succeeded = succeeded | info["success"]
        if is_cloth:
            crossed = crossed | (info["self_crossings"] > 0)
    env.close()
    return {
        "env": env_id,
        "options": options,
        "success_once": succeeded.float().mean().item(),
        "success_at_end": info["success"].float().mean().item(),
        "crossed": int(crossed.sum()),
        "crossed_at_end": int((info["self_crossings"] > 0).sum()) if is_cloth else 0,
        "dropped_contacts": int(info["dropped_contacts"].max()),
        "num_episodes": num_episodes,
    }


def main() -> None:
    """Parse the command line, play, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=48, help="episodes of each configuration")
    parser.add_argument("--json", type=Path, help="file for the rows")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    for env_id, options in CONFIGURATIONS:
        rows.append(play(env_id, options, arguments.episodes))
        sys.stdout.write(json.dumps(rows[-1]) + "\n")
        sys.stdout.flush()
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
