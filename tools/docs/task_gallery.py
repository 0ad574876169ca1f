"""Pictures of all tasks: for each a still and a clip of the scripted expert, one clip of all of them side by side, one of arms.

python -m tools.docs.task_gallery [--folder docs/images]

Writes <id of the task>.png and .gif, tasks.gif and arms.gif.
The clips end a second after the expert has succeeded; they run in real time.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from mani_skill.utils.registration import REGISTERED_ENVS
from mani_skill.utils.sapien_utils import look_at
from PIL import Image

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.experts import EXPERTS, make_expert
from maniskill_grpd.runs.environments import join_actions


class Episode(NamedTuple):
    """What is shown of a task."""

    seed: int = 0
    field_of_view: float | None = None
    """Vertical field of view [rad]; that of the task's camera, the default, is wide enough for every episode."""
    target: tuple[float, float, float] | None = None
    """Where the camera looks [m]; by default where that of the task does."""
    options: dict[str, Any] = {}
    """Options of the task."""
    position: tuple[float, float, float] | None = None
    """Where the camera stands [m]; by default where that of the task does."""


CLOSE_UPS = {
    "RopeShaping-v1": Episode(11, 0.8, (0.0, 0.0, 0.0)),
    "RopeWrapping-v1": Episode(8, 0.68, (0.0, 0.05, 0.0)),
    "ClothFolding-v1": Episode(3, 0.6, (0.0, 0.07, 0.0)),
    "ClothHanging-v1": Episode(1, 0.42, (0.3, 0.0, -0.25), {"release": True}),
}
"""Tasks that are shown closer than their cameras do."""
ARMS = Episode(5, 0.62, (0.0, 0.0, 0.2), {"robot_uids": ("panda", "panda")}, (1.75, -0.5, 1.0))
"""The episode of ClothFolding-v1 that two Pandas play."""
STILL_SHARE = 0.6
"""Share of the way to success at which the still is taken."""
NUM_LAST_FRAMES = 20
"""Frames after the success."""
FRAME_TIME = 50
"""Milliseconds per frame: a control step."""
CLIP_SIZE, ARMS_SIZE = 320, 400
"""Sides of the clips, and of that of the arms [pixels]."""


def episodes() -> dict[str, Episode]:
    """Return what is shown, by the id of the task: every task with an expert."""
    return {env_id: CLOSE_UPS.get(env_id, Episode()) for env_id in dict.fromkeys([*CLOSE_UPS, *sorted(EXPERTS)])}


def play_expert(env_id: str, episode: Episode) -> tuple[list[Image.Image], int]:
    """Play one episode.

    Returns:
        What the camera of the task saw, at the start and after each step, until a second after the first success, and the number
        of steps to it.

    Raises:
        RuntimeError: If the expert does not succeed.
    """
    task = REGISTERED_ENVS[env_id].cls
    target = task.CAMERA_TARGET if episode.target is None else episode.target
    camera = {"fov": episode.field_of_view or task.CAMERA_FOV, "pose": look_at(episode.position or task.CAMERA_POSITION, target)}
    env = gym.make(env_id, sim_backend="cpu", render_mode="rgb_array", human_render_camera_configs=camera, **episode.options)
    env = join_actions(env)
    env.reset(seed=episode.seed)
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
        raise RuntimeError(f"the expert of {env_id} does not succeed from seed {episode.seed}")
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
    parser.add_argument("--folder", type=Path, default=Path("docs/images"), help="where to write the pictures")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    clips = []
    for env_id, episode in episodes().items():
        frames, num_steps = play_expert(env_id, episode)
        frames[round(STILL_SHARE * num_steps)].save(folder / f"{env_id}.png", optimize=True)
        clips.append([frame.resize((CLIP_SIZE, CLIP_SIZE), Image.Resampling.BOX) for frame in frames])
        write_clip(clips[-1], folder / f"{env_id}.gif")
        print(f"{env_id}: success after {num_steps} steps, {len(frames)} frames")
    write_clip(side_by_side(clips), folder / "tasks.gif")
    frames, _ = play_expert("ClothFolding-v1", ARMS)
    write_clip([frame.resize((ARMS_SIZE, ARMS_SIZE), Image.Resampling.BOX) for frame in frames], folder / "arms.gif")


if __name__ == "__main__":
    main()
