"""Replay recorded trajectories of our tasks, in another observation mode for example.

    python -m maniskill_grpd.trajectory.replay --traj-path trajectory.h5 --save-traj -o state

Flags and output are those of `python -m mani_skill.trajectory.replay_trajectory`, which does not know these tasks. With `-n 16`
sixteen episodes are replayed side by side in one process, on the CPU as well.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import torch
import tyro
from mani_skill.trajectory import replay_trajectory
from mani_skill.trajectory.utils import list_of_dicts_to_dict
from mani_skill.utils.registration import REGISTERED_ENVS
from tqdm import tqdm

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.tasks import DeformableEnv
from maniskill_grpd.tasks.options.compute_device import choose_compute_device
from maniskill_grpd.trajectory.episode_recorder import EpisodeRecorder
from maniskill_grpd.trajectory.recorded_states import RecordedStates
from maniskill_grpd.trajectory.recording import Episode, Recording, RecordingError, read_recording


@dataclass
class ReplayOptions(replay_trajectory.Args):
    """The options of ManiSkill's tool; `max_retry` changes nothing, as a replay is the same each time."""

    allow_import: Annotated[bool, tyro.conf.arg(aliases=["--allow_import"])] = False
    """Whether the id of the task in the recording may be of the form module:id, which runs the code of that module"""


def replay(arguments: Sequence[str]) -> int:
    """Replay as the command line says.

    Returns:
        Number of episodes that ended as wanted: in success unless failures are allowed, in time with `--discard-timeout`.

    Raises:
        FileNotFoundError: If there is no trajectory, or not the .json file beside it.
        FileExistsError: If the output is there already.
        ValueError: If the recording cannot be used or an option does not fit it. No output is left then.
    """
    options = tyro.cli(ReplayOptions, args=list(arguments), description=__doc__)
    for name in ("num_envs", "count"):
        if (number := getattr(options, name)) is not None and number < 1:
            raise ValueError(f"{name} must be >= 1, got {number}")
    recording = read_recording(Path(options.traj_path), count=options.count, allow_import=options.allow_import)
    _check_options(options, recording)
    env = RecordedStates(_make_env(options, recording))
    recorder = _make_recorder(options, recording, env)
    episodes, size = recording.episodes, options.num_envs
    num_kept = 0
    try:
        for first in tqdm(range(0, len(episodes), size), desc="replay", unit="batch"):
            num_kept += _replay_batch(options, env, recorder, episodes[first : first + size])
    except BaseException:
        recorder.discard()
        raise
    recorder.close()
    print(f"Replayed {len(episodes)} episodes, {num_kept}/{len(episodes)}={num_kept / len(episodes):.2%} demos saved")
    return num_kept


def _check_options(options: ReplayOptions, recording: Recording) -> None:
    modes = {episode.control_mode for episode in recording.episodes} | {options.target_control_mode} - {None}
    if len(modes) > 1:
        raise ValueError(f"actions cannot be converted from one control mode to another: {sorted(modes)}")
    if options.use_env_states or options.use_first_env_state:
        without = [episode.name for episode in recording.episodes if episode.states is None]
        if without:
            raise RecordingError(f"{recording.path} has no states of {without[0]}; replay its actions")


def _make_env(options: ReplayOptions, recording: Recording) -> gym.Env:
    recorded = recording.env_kwargs
    device = choose_compute_device(options.sim_backend or recorded.get("sim_backend", "auto"))
    needs_pictures = options.save_video or options.vis
    settings = {
        **recorded,
        "num_envs": options.num_envs,
        "sim_backend": device.type,
        "obs_mode": options.obs_mode or recorded.get("obs_mode"),
        "control_mode": recording.episodes[0].control_mode,
        "reward_mode": options.reward_mode,
        "render_mode": options.render_mode if needs_pictures else None,
        "max_episode_steps": recording.max_episode_steps,
    }
    if options.shader is not None:
        settings["shader_dir"] = options.shader
    module, _, name = recording.env_id.rpartition(":")
    if module:
        import_module(module)
    if name not in REGISTERED_ENVS or not issubclass(REGISTERED_ENVS[name].cls, DeformableEnv):
        raise RecordingError(f"{recording.path} is of {recording.env_id}, which is none of the tasks that are replayed here")
    try:
        return gym.make(recording.env_id, **settings)
    except TypeError as error:
        raise RecordingError(f"{recording.env_id} cannot be made with the env_kwargs of {recording.path}: {error}") from error


def _make_recorder(options: ReplayOptions, recording: Recording, env: gym.Env) -> EpisodeRecorder:
    base = env.unwrapped
    stem = recording.path.name.split(".")[0]
    name = f"{stem}.{base.obs_mode}.{recording.episodes[0].control_mode}.{base.backend.sim_backend}"
    output = recording.path.with_name(f"{name}.h5")
    if options.save_traj and output.exists():
        env.close()
        raise FileExistsError(f"{output} exists; move it away first")
    return EpisodeRecorder(
        env,
        recording.path.parent,
        trajectory_name=name,
        save_trajectory=options.save_traj,
        save_video=options.save_video,
        record_reward=options.record_rewards,
        save_on_reset=False,
        max_steps_per_video=sys.maxsize,  # a video is written when its batch is over
        video_fps=base.control_freq if options.video_fps is None else options.video_fps,
    )


def _replay_batch(options: ReplayOptions, env: RecordedStates, recorder: EpisodeRecorder, episodes: Sequence[Episode]) -> int:
    """Replay episodes side by side, in as many worlds or more; return how many are wanted."""
    num_steps = np.array([len(episode.actions) for episode in episodes])
    # The worlds left over in the last batch repeat its last episode, and are not kept.
    padded = [*episodes, *[episodes[-1]] * (options.num_envs - len(episodes))]
    num_states = num_steps.max() + 1 if options.use_env_states else int(options.use_first_env_state)
    env.follow([list_of_dicts_to_dict([episode.state(step) for episode in padded]) for step in range(num_states)])
    recorder.reset(seed=[episode.seed for episode in padded])
    num_wanted = 0
    for step in range(num_steps.max()):
        *_, truncated, info = recorder.step(_actions_at(padded, step))
        if options.vis:
            recorder.base_env.render_human()
        wanted = _wanted(options, info, truncated)[: len(episodes)] & (num_steps == step + 1)
        num_wanted += int(wanted.sum())
        if options.save_traj and wanted.any():
            recorder.keep(wanted.nonzero()[0])
    if options.save_traj:
        recorder.drop()
    recorder.flush_video(save=bool(num_wanted))
    return num_wanted


def _actions_at(episodes: Sequence[Episode], step: int) -> np.ndarray:
    """Return the actions of a step (B, D); zeros where an episode is over."""
    return np.stack([e.actions[step] if step < len(e.actions) else np.zeros_like(e.actions[0]) for e in episodes])


def _wanted(options: ReplayOptions, info: dict[str, Any], truncated: torch.Tensor) -> np.ndarray:
    """Return in which worlds an episode that ends now is to be kept, (B,) bool."""
    wanted = torch.ones_like(truncated) if options.allow_failure else info["success"]
    return (wanted & ~truncated if options.discard_timeout else wanted).cpu().numpy()


def main(arguments: Sequence[str]) -> int:
    """Replay; report what the user can fix in one line instead of a traceback."""
    try:
        replay(arguments)
    except (OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
