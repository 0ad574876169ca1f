"""Record a video of a checkpoint at work, several episodes side by side.

maniskill-grpd video --checkpoint runs/NAME/final_ckpt.pt --output policy.mp4
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.options import require_positive
from maniskill_grpd.runs.checkpoints import load_policy
from maniskill_grpd.runs.play import change_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED
from maniskill_grpd.runs.video import record_video


@dataclass(frozen=True, kw_only=True)
class VideoConfig:
    """Options of the video."""

    checkpoint: Path
    """the checkpoint that acts"""
    output: Path | None = None
    """the mp4 to write, a gif where ffmpeg is missing; by default policy.mp4 beside the checkpoint"""
    num_episodes: int = 4
    """episodes, side by side"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode"""
    env_id: str | None = None
    """id of the task, if not the one of the training"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs that replace or extend those of the training"""
    allow_import: bool = False
    """whether the id of the task in the checkpoint may be of the form module:id, which runs the code of that module"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes")


def record(config: VideoConfig) -> None:
    """Record, and say where."""
    torch.set_num_threads(1)
    policy, contents = load_policy(config.checkpoint, allow_import=config.allow_import)
    task = change_task(TrainConfig.from_dict(contents["train_config"]), config.env_id, config.env_kwargs)
    path = config.output or config.checkpoint.with_name("policy.mp4")
    print(record_video(policy, task, range(config.seed, config.seed + config.num_episodes), path))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(record, VideoConfig, arguments)
