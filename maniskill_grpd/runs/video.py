"""Video of a policy at work, several episodes side by side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import torch

from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.tasks.pictures.world_pictures import MAX_DRAWN_WORLDS


def record_video(policy: Policy, config: TrainConfig, seeds: Sequence[int], path: Path, fps: int = 20) -> Path:
    """Play episodes at the same time and write what the task's camera sees, in a grid as square as possible.

    Args:
        policy: Acts with the mean of its distribution.
        config: Names the task.
        seeds: One per episode, at most 16.
        path: The mp4 to write; where ffmpeg is missing a gif of the same name is written instead.
        fps: Frames per second; 20 is real time.

    Returns:
        The file that was written.

    Raises:
        ValueError: If there are more episodes than an environment draws.
    """
    if len(seeds) > MAX_DRAWN_WORLDS:
        raise ValueError(f"a video shows at most {MAX_DRAWN_WORLDS} episodes, got {len(seeds)} seeds")
    env = make_env(config, len(seeds), render_mode="rgb_array")
    frames: list[np.ndarray] = []
    evaluate_policy(policy, env, seeds, on_step=lambda: frames.append(tile(env.render())))
    env.close()
    return write_frames(frames, path, fps)


def tile(images: torch.Tensor) -> np.ndarray:
    """Return pictures (n, H, W, 3 or 4) in a grid, row by row, as uint8 (height, width, 3) with even sides, as codecs want it."""
    pictures = images.cpu().numpy()[..., :3].astype(np.uint8)
    columns = math.ceil(math.sqrt(len(pictures)))
    rows = math.ceil(len(pictures) / columns)
    num, height, width, _ = pictures.shape
    grid = np.full((rows * columns, height, width, 3), 255, dtype=np.uint8)
    grid[:num] = pictures
    grid = grid.reshape(rows, columns, height, width, 3).swapaxes(1, 2).reshape(rows * height, columns * width, 3)
    return np.ascontiguousarray(grid[: len(grid) // 2 * 2, : columns * width // 2 * 2])


def write_frames(frames: list[np.ndarray], path: Path, fps: int = 20) -> Path:
    """Write frames (height, width, 3) as an mp4, or as a gif of the same name where ffmpeg is missing; return the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        path = path.with_suffix(".gif")
        imageio.mimsave(path, frames, duration=1000 / fps, loop=0)
        return path
    imageio.mimsave(path, frames, fps=fps, macro_block_size=2)
    return path
