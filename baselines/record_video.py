"""Video of a policy at work."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import torch
from run_setup import make_env

from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.policies import Policy


def record_video(
    policy: Policy, config: TrainConfig, seeds: Sequence[int], path: Path, fps: int = 20
) -> Path:
    """Play episodes one after the other and write what the task's camera sees.

    Args:
        policy: Acts with the mean of its distribution.
        config: Names the task.
        seeds: One per episode.
        path: The mp4 to write; where ffmpeg is missing a gif of the same name is written instead.
        fps: Frames per second; 20 is real time.

    Returns:
        The file that was written.
    """
    env = make_env(config, 1, render_mode="rgb_array")
    frames: list[np.ndarray] = []
    evaluate_policy(policy, env, seeds, on_step=lambda: frames.append(_frame(env.render())))
    env.close()
    path.parent.mkdir(parents=True, exist_ok=True)
    return _write(frames, path, fps)


def _frame(image: torch.Tensor | np.ndarray) -> np.ndarray:
    """Return the picture of the first world as uint8 (H, W, 3) with even sides, as codecs want it."""
    array = torch.as_tensor(image).cpu().numpy()
    array = array[0] if array.ndim == 4 else array
    height, width = (side - side % 2 for side in array.shape[:2])
    return np.ascontiguousarray(array[:height, :width, :3].astype(np.uint8))


def _write(frames: list[np.ndarray], path: Path, fps: int) -> Path:
    try:
        import imageio_ffmpeg

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        path = path.with_suffix(".gif")
        imageio.mimsave(path, frames, duration=1000 / fps, loop=0)
        return path
    imageio.mimsave(path, frames, fps=fps, macro_block_size=2)
    return path
