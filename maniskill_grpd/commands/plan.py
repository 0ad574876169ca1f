"""Play a task by planning: plans are tried in copies of the simulation, the best is followed for a few steps, and so on.

maniskill-grpd plan --env_id ClothFolding-v1
maniskill-grpd plan --checkpoint runs/NAME/final_ckpt.pt --std 0.2 --iterations 1 --json planned.json
maniskill-grpd plan --env_id RopeShaping-v1 --env_kwargs goal_shape=S --num_episodes 100 --record demos/S

No task is known here, only its rewards: an expert for tasks that have none. With --checkpoint plans start from what a policy
would do, which is then refined. `clone --demonstrations` and `train --demonstrations` learn from what --record writes.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.planning.episodes import PlanConfig, PlannedEpisodes, plan_episodes
from maniskill_grpd.planning.options import PlannerOptions
from maniskill_grpd.runs.episodes import describe_episodes, write_episodes


def plan_and_report(config: PlanConfig) -> None:
    """Plan, print a table and write what was asked for."""
    planned = plan_episodes(config)
    task, last = planned.task, config.seed + config.num_episodes - 1
    print(f"{task.env_id} {' '.join(task.env_kwargs)}: {config.num_episodes} episodes, seeds {config.seed} to {last}")
    print(describe_episodes(planned.episodes))
    if planned.recording is not None:
        print(f"{planned.recording}: {planned.num_recorded} of {config.num_episodes} episodes")
    if planned.video is not None:
        print(f"video: {planned.video}")
    if config.json is not None:
        write_episodes(config.json, _facts(config, planned), planned.episodes, indent=2)


def _facts(config: PlanConfig, planned: PlannedEpisodes) -> dict[str, object]:
    return {
        "env_id": planned.task.env_id,
        "env_kwargs": planned.task.env_options,
        "checkpoint": config.checkpoint and str(config.checkpoint),
        "use_value": config.use_value,
        "planner": {field.name: getattr(config, field.name) for field in dataclasses.fields(PlannerOptions)},
        "first_seed": config.seed,
        "num_episodes": config.num_episodes,
    }


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(plan_and_report, PlanConfig, arguments)
