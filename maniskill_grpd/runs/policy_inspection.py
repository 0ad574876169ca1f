"""Examine the policy of a checkpoint over an episode, and draw what it looks at."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.inspection import play_episode
from maniskill_grpd.runs.inspection_figures import write_inspection
from maniskill_grpd.runs.play import change_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED


@dataclass(frozen=True, kw_only=True)
class InspectionConfig:
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


def inspect_policy(config: InspectionConfig) -> tuple[list[str], list[Path]]:
    """Examine as configured.

    Returns:
        Lines that say how evenly the influence of the nodes is spread, and the pictures written.

    Raises:
        CheckpointError: If the file is no checkpoint, or of a policy for other observations than the task gives.
        ValueError: If the task does not exist or does not take its options.
    """
    torch.set_num_threads(1)
    policy, contents = load_policy(config.checkpoint, allow_import=config.allow_import)
    task = change_task(TrainConfig.from_dict(contents["train_config"]), config.env_id, config.env_kwargs, config.sim_backend)
    graphs = play_episode(policy, task, config.seed)
    steps = sorted({min(step, len(graphs) - 1) for step in config.steps})
    paths, lines = write_inspection(policy, graphs, steps, config.output or config.checkpoint.parent)
    return lines, paths
