"""Episodes played by a planner."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch

from maniskill_grpd.learning import TrainConfig, evaluate_policy
from maniskill_grpd.learning.options import THREADS, check_ranges, require_positive
from maniskill_grpd.planning.actor import PlanningActor
from maniskill_grpd.planning.options import PlannerOptions
from maniskill_grpd.planning.planner import Planner
from maniskill_grpd.planning.policy_prior import PolicyPrior
from maniskill_grpd.planning.sample_worlds import SampleWorlds
from maniskill_grpd.runs.environments import find_task, make_env
from maniskill_grpd.runs.play import change_task
from maniskill_grpd.runs.seeds import FIRST_TEST_SEED
from maniskill_grpd.runs.video import tile, write_frames
from maniskill_grpd.tasks.pictures.world_pictures import MAX_DRAWN_WORLDS
from maniskill_grpd.trajectory.episode_recorder import EpisodeRecorder


@dataclass(frozen=True, kw_only=True)
class PlanConfig(PlannerOptions):
    """Options of episodes that are planned."""

    env_id: str | None = None
    """id of the task; with a checkpoint by default that of its training"""
    env_kwargs: tuple[str, ...] = ()
    """options of the task as key=value pairs, values in JSON; with a checkpoint they replace or extend those of its training"""
    checkpoint: Path | None = None
    """policy that proposes plans"""
    use_value: bool = False
    """let the value function of the policy stand for the future after a plan, in place of final_weight"""
    num_episodes: int = 20
    """number of episodes, each with its own seed"""
    num_envs: int = 4
    """number of episodes that are planned at the same time, each in `samples` worlds"""
    seed: int = FIRST_TEST_SEED
    """seed of the first episode"""
    sim_backend: str | None = None
    """where the simulation runs: auto (cuda if there is a GPU), cpu or cuda; with a checkpoint by default as in its training"""
    torch_threads: int = 1
    """CPU threads PyTorch uses"""
    allow_import: bool = False
    """whether the id of the task in the checkpoint may be of the form module:id, which runs the code of that module"""
    record: Path | None = None
    """also write the episodes that end in success as trajectory.h5 and .json into this folder"""
    keep_failures: bool = False
    """record the others too"""
    video: Path | None = None
    """also write a video of the episodes that are planned first, side by side, to this mp4"""
    json: Path | None = None
    """also write the results, per episode, to this file"""

    def __post_init__(self) -> None:
        self.check()
        require_positive(self, "num_episodes", "num_envs")
        check_ranges(self, {"torch_threads": THREADS})

    def contradictions(self) -> dict[str, bool]:
        """See `OptionGroup.contradictions`."""
        return {
            **super().contradictions(),
            "give the task as --env_id, or a policy as --checkpoint": self.env_id is None and self.checkpoint is None,
            "--use_value needs the value function of a --checkpoint": self.use_value and self.checkpoint is None,
            "--keep_failures needs --record": self.keep_failures and self.record is None,
            f"a video shows at most {MAX_DRAWN_WORLDS} episodes, num_envs is {self.num_envs}": (
                self.video is not None and self.num_envs > MAX_DRAWN_WORLDS
            ),
        }


@dataclass(frozen=True, kw_only=True)
class PlannedEpisodes:
    """What was planned.

    Attributes:
        task: Names the task and its options.
        episodes: Results per episode, as `evaluate_policy` gives them, and what they cost: `plan_seconds` of wall-clock time, and
            `plan_steps` of the environment in which plans were tried.
        recording: The trajectories, if they were wanted.
        num_recorded: Episodes in it.
        video: The video, if it was wanted.
    """

    task: TrainConfig
    episodes: dict[str, torch.Tensor]
    recording: Path | None = None
    num_recorded: int = 0
    video: Path | None = None


def plan_episodes(config: PlanConfig) -> PlannedEpisodes:
    """Plan as configured.

    Raises:
        ValueError: If the task does not exist, does not take its options, or cannot be planned in.
        CheckpointError: If the prior is no checkpoint, or of a policy for other observations than the task gives.
        FileExistsError: If there is a recording already.
    """
    torch.set_num_threads(config.torch_threads)
    prior = None if config.checkpoint is None else PolicyPrior.load(config.checkpoint, allow_import=config.allow_import)
    task = choose_task(config, prior)
    num_envs = min(config.num_envs, config.num_episodes)
    trajectory = None if config.record is None else config.record / "trajectory.h5"
    if trajectory is not None and trajectory.exists():
        raise FileExistsError(f"{trajectory} exists; choose another folder to --record")
    env = make_env(task, num_envs, **({"render_mode": "rgb_array"} if config.video else {}))
    planner = make_planner(task, num_envs, config, prior, use_value=config.use_value)
    played = _record(env, config.record) if config.record else env
    seeds = range(config.seed, config.seed + config.num_episodes)
    frames: list[np.ndarray] = []
    chunks, num_recorded = [], 0
    for first in range(0, len(seeds), num_envs):
        show = (lambda: frames.append(tile(env.render()))) if config.video and not first else None
        chunks.append(play_chunk(played, planner, seeds[first : first + num_envs], on_step=show))
        if isinstance(played, EpisodeRecorder):
            kept = (chunks[-1]["success_at_end"] | config.keep_failures).nonzero()[:, 0]
            played.keep(kept.numpy())
            played.drop()
            num_recorded += len(kept)
    played.close()
    planner.worlds.close()
    return PlannedEpisodes(
        task=task,
        episodes={name: torch.cat([chunk[name] for chunk in chunks]) for name in chunks[0]},
        recording=trajectory,
        num_recorded=num_recorded,
        video=write_frames(frames, config.video) if config.video else None,
    )


def choose_task(config: PlanConfig, prior: PolicyPrior | None) -> TrainConfig:
    """Return the task that the options name, which is that of the prior's training where they are silent."""
    if prior is not None:
        return change_task(prior.trained, config.env_id, config.env_kwargs, config.sim_backend)
    assert config.env_id is not None
    return TrainConfig(env_id=config.env_id, env_kwargs=config.env_kwargs, sim_backend=config.sim_backend or "auto")


def make_planner(
    task: TrainConfig, num_episodes: int, options: PlannerOptions, prior: PolicyPrior | None = None, *, use_value: bool = False
) -> Planner:
    """Make a planner with worlds of its own.

    Args:
        task: Names the task and its options.
        num_episodes: Number of episodes that are planned at the same time.
        options: Options of the planner.
        prior: A policy that proposes plans.
        use_value: Whether its value function stands for the future after a plan.

    Raises:
        ValueError: If the task cannot be planned in, or the values of the prior were never trained.
        CheckpointError: If the prior does not fit the task.
    """
    if use_value and (prior is None or prior.value_scale is None):
        raise ValueError("the value function of the policy was never trained, as after cloning: leave --use_value out")
    env = _make_sample_env(task, num_episodes * options.samples, needs_graph=prior is not None)
    if prior is not None:
        prior.check(env)
        prior.policy.to(env.unwrapped.device)
    discount, value = (prior.discount, prior.value) if prior is not None and use_value else (1.0, None)
    worlds = SampleWorlds(env, options.samples, discount=discount, final_weight=options.final_weight, value=value)
    return Planner(worlds, options, prior)


def _make_sample_env(task: TrainConfig, num_envs: int, *, needs_graph: bool) -> gym.Env:
    """Make the environment of the plans, which observes only what somebody looks at; what was seen may be part of the state."""
    options = task.env_options
    find_task(task.env_id)
    options["obs_mode"] = "graph" if needs_graph or {"visibility", "keypoints"} & set(options) else "none"
    return gym.make(task.env_id, num_envs=num_envs, sim_backend=task.sim_backend, **options)


def play_chunk(
    env: gym.Env, planner: Planner, seeds: Sequence[int], on_step: Callable[[], None] | None = None
) -> dict[str, torch.Tensor]:
    """Play one episode per seed at the same time; results as of `PlannedEpisodes`."""
    num_envs = planner.worlds.num_episodes
    padded = [*seeds, *[seeds[-1]] * (num_envs - len(seeds))]
    planner.begin(padded)
    start, steps = time.perf_counter(), planner.worlds.num_steps
    episodes = evaluate_policy(PlanningActor(planner, env), env, padded, on_step=on_step)
    cost = {"plan_seconds": (time.perf_counter() - start) / num_envs, "plan_steps": (planner.worlds.num_steps - steps) / num_envs}
    episodes |= {name: torch.full((num_envs,), value) for name, value in cost.items()}
    return {name: values[: len(seeds)] for name, values in episodes.items()}


def _record(env: gym.Env, folder: Path) -> EpisodeRecorder:
    return EpisodeRecorder(
        env,
        folder,
        trajectory_name="trajectory",
        save_video=False,
        save_on_reset=False,
        source_type="motionplanning",
        source_desc="maniskill_grpd.planning",
    )
