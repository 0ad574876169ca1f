"""Demonstrations of a task's expert in ManiSkill's trajectory format."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
from mani_skill.utils import gym_utils
from tqdm import tqdm

from maniskill_grpd.experts import make_expert
from maniskill_grpd.learning.options import parse_options, require_positive
from maniskill_grpd.runs.replays import Filming
from maniskill_grpd.trajectory.episode_recorder import EpisodeRecorder

MOST_FILMED = 4
"""Episodes of a replay."""


@dataclass(frozen=True, kw_only=True)
class RecordConfig:
    """Options of a recording."""

    env_id: str = "RopeShaping-v1"
    """id of the task"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs, values in JSON"""
    num_episodes: int = 100
    """number of episodes, each with its own seed; those that fail are left out of the file"""
    num_envs: int = 20
    """number of environments that run in parallel"""
    seed: int = 0
    """seed of the first episode; evaluations use seeds from 500,000 up"""
    output: Path | None = None
    """folder to write to, by default demos/{env_id}"""
    html: Path | None = None
    """also write a replay of the first episodes, at most four, to this file"""
    keep_failures: bool = False
    """also keep episodes that do not end in success"""
    sim_backend: str = "auto"
    """where the simulation runs: auto (cuda if there is a GPU), cpu or cuda"""

    def __post_init__(self) -> None:
        require_positive(self, "num_episodes", "num_envs")


def record(config: RecordConfig) -> tuple[Path, int]:
    """Record as configured.

    Returns:
        The file of the trajectories, and how many it holds.

    Raises:
        FileExistsError: If there is one already.
    """
    folder = config.output or Path("demos") / config.env_id
    path = folder / "trajectory.h5"
    if path.exists():
        raise FileExistsError(f"{path} exists; choose another --output")
    if config.html is not None and config.html.exists():
        raise FileExistsError(f"{config.html} exists; choose another --html")
    num_envs = min(config.num_envs, config.num_episodes)
    options = {"obs_mode": "graph", **parse_options("env_kwargs", config.env_kwargs)}
    env = gym.make(config.env_id, num_envs=num_envs, sim_backend=config.sim_backend, **options)
    num_steps = gym_utils.find_max_episode_steps_value(env)
    expert = make_expert(config.env_id, env)
    recorder = EpisodeRecorder(
        env,
        folder,
        trajectory_name="trajectory",
        save_video=False,
        save_on_reset=False,
        source_type="scripted",
        source_desc=f"the expert of {config.env_id}",
    )
    filmed = range(min(num_envs, MOST_FILMED))
    filming = Filming(env, filmed, f"the expert of {config.env_id}, seeds {config.seed} to {config.seed + len(filmed) - 1}")
    kept = 0
    for first in tqdm(range(0, config.num_episodes, num_envs), desc="demonstrations", unit="batch"):
        recorder.reset(seed=list(range(config.seed + first, config.seed + first + num_envs)))
        is_filmed = first == 0 and config.html is not None
        if is_filmed:
            filming.shoot()
        for _ in range(num_steps):
            info = recorder.step(expert.act())[4]
            if is_filmed:
                filming.shoot()
        wanted = info["success"] | config.keep_failures
        wanted[config.num_episodes - first :] = False
        recorder.keep(wanted.nonzero()[:, 0].cpu().numpy())
        recorder.drop()
        kept += int(wanted.sum())
    recorder.close()
    if config.html is not None:
        filming.replay.write(config.html)
    return path, kept
