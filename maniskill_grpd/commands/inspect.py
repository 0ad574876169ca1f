"""Draw what a policy looks at.

maniskill-grpd inspect --checkpoint runs/NAME/final_ckpt.pt --steps 0 15 30

Plays one episode and writes to the folder of the checkpoint, or to --output:

sensitivity.png    per actuator and step, how its mean action changes when an object node moves, |d a_v / d p_u| (eq. 11, 47),
                   drawn on the object; the node's goal stays fixed in space, so that its offset from the goal changes too
contribution.png   per actuator and step, how far its mean action changes when an object node is taken out of the graph
embedding.png      features of the object nodes after message passing, all steps of the episode, on their first two principal
                   components; coloured by place along the object, distance to the goal and step

and prints how evenly the influence of the nodes is spread. Works for every policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.inspection import play_episode
from maniskill_grpd.runs.inspection_figures import write_inspection
from maniskill_grpd.runs.play import change_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED


@dataclass(frozen=True, kw_only=True)
class InspectConfig:
    """Options of an inspection."""

    checkpoint: Path
    """the checkpoint of the policy"""
    output: Path | None = None
    """folder of the pictures; by default that of the checkpoint"""
    seed: int = FIRST_TEST_SEED
    """seed of the episode"""
    steps: tuple[int, ...] = (0, 15, 30)
    """steps of the episode at which nodes are examined"""
    env_id: str | None = None
    """id of the task, if not the one of the training"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs that replace or extend those of the training"""
    allow_import: bool = False
    """whether the id of the task in the checkpoint may be of the form module:id, which runs the code of that module"""
    sim_backend: str = "cpu"
    """where the simulation runs"""

    def __post_init__(self) -> None:
        if not self.steps or min(self.steps) < 0:
            raise ValueError(f"steps must be at least one number >= 0, got {self.steps}")


def inspect(config: InspectConfig) -> None:
    """Examine as configured, and say where the pictures are."""
    torch.set_num_threads(1)
    policy, contents = load_policy(config.checkpoint, allow_import=config.allow_import)
    task = change_task(TrainConfig.from_dict(contents["train_config"]), config.env_id, config.env_kwargs, config.sim_backend)
    graphs = play_episode(policy, task, config.seed)
    steps = sorted({min(step, len(graphs) - 1) for step in config.steps})
    paths, lines = write_inspection(policy, graphs, steps, config.output or config.checkpoint.parent)
    print("\n".join(lines))
    print("pictures: " + ", ".join(map(str, paths)))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(inspect, InspectConfig, arguments)
