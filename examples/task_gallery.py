"""Pictures of all tasks: for each a still and a clip of the scripted expert, and one clip of all of them side by side.

python examples/task_gallery.py --folder docs/images

Writes <id of the task>.png and .gif, and tasks.gif. The clips end a second after the expert has succeeded; they run in real time.
"""

import argparse
from pathlib import Path

import gymnasium as gym
import numpy as np
from PIL import Image

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.experts import EXPERTS, make_expert

SEEDS = {"RopeShaping-v1": 11, "RopeWrapping-v1": 8, "ClothFolding-v1": 3, "ClothHanging-v1": 5}
"""Seed of the episode that is shown."""
FIELDS_OF_VIEW = {"ClothHanging-v1": 0.58, "RopeShaping-v1": 0.8}
"""Vertical field of view [rad] where it is not `FIELD_OF_VIEW`: only these episodes must fit in."""
FIELD_OF_VIEW = 0.7
STILL_SHARE = 0.6
"""Share of the way to success at which the still is taken."""
NUM_LAST_FRAMES = 20
"""Frames after the success."""
FRAME_TIME = 50
"""Milliseconds per frame: a control step."""
CLIP_SIZE = 320
"""Side of the clips [pixels]."""


def play_expert(env_id: str, seed: int) -> tuple[list[Image.Image], int]:
    """Play one episode.

    Returns:
        What the camera of the task saw, at the start and after each step, until a second after the first success, and the number
        of steps to it.

    Raises:
        RuntimeError: If the expert does not succeed.
    """
    camera = {"fov": FIELDS_OF_VIEW.get(env_id, FIELD_OF_VIEW)}
    env = gym.make(
        env_id, num_envs=1, sim_backend="cpu", render_mode="rgb_array", human_render_camera_configs=camera
    )
    env.reset(seed=seed)
    expert = make_expert(env_id, env)
    frames, num_steps = [_frame(env)], None
    while num_steps is None or len(frames) <= num_steps + NUM_LAST_FRAMES:
        _, _, _, is_over, info = env.step(expert.act())
        frames.append(_frame(env))
        if num_steps is None and info["success"].all():
            num_steps = len(frames) - 1
        if is_over.all():
            break
    env.close()
    if num_steps is None:
        raise RuntimeError(f"the expert of {env_id} does not succeed from seed {seed}")
    return frames, num_steps


def write_clip(frames: list[Image.Image], path: Path) -> None:
    """Write an animation that holds its last frame for a second."""
    colors = _stack(frames[:: max(len(frames) // 8, 1)]).quantize(256, dither=Image.Dither.NONE)
    first, *others = (frame.quantize(palette=colors, dither=Image.Dither.NONE) for frame in frames)
    durations = [FRAME_TIME] * len(others) + [1000]
    first.save(path, save_all=True, append_images=others, duration=durations, loop=0, optimize=True)


def side_by_side(clips: list[list[Image.Image]]) -> list[Image.Image]:
    """Return the frames of a clip in which clips run in a grid as square as possible; short ones wait at their end."""
    columns = int(np.ceil(np.sqrt(len(clips))))
    rows = int(np.ceil(len(clips) / columns))
    width, height = clips[0][0].size
    frames = []
    for index in range(max(map(len, clips))):
        grid = Image.new("RGB", (columns * width, rows * height), "white")
        for cell, clip in enumerate(clips):
            grid.paste(clip[min(index, len(clip) - 1)], (cell % columns * width, cell // columns * height))
        frames.append(grid)
    return frames


def _frame(env: gym.Env) -> Image.Image:
    return Image.fromarray(env.render()[0].cpu().numpy())


def _stack(frames: list[Image.Image]) -> Image.Image:
    return Image.fromarray(np.concatenate([np.asarray(frame) for frame in frames]))


def main() -> None:
    """Parse the command line, play all experts and write the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="where to write the pictures")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    clips = []
    for env_id in EXPERTS:
        frames, num_steps = play_expert(env_id, SEEDS[env_id])
        frames[round(STILL_SHARE * num_steps)].save(folder / f"{env_id}.png", optimize=True)
        clips.append([frame.resize((CLIP_SIZE, CLIP_SIZE), Image.Resampling.BOX) for frame in frames])
        write_clip(clips[-1], folder / f"{env_id}.gif")
        print(f"{env_id}: success after {num_steps} steps, {len(frames)} frames")
    write_clip(side_by_side(clips), folder / "tasks.gif")


if __name__ == "__main__":
    main()
