"""The player: owns an environment, lets an agent act in it in real time, and does what it is asked for between two steps."""

from __future__ import annotations

import contextlib
import queue
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import gymnasium as gym
import torch
from mani_skill.utils.wrappers.flatten import FlattenActionSpaceWrapper

from maniskill_grpd.learning import CheckpointError, NonFiniteError, TrainConfig
from maniskill_grpd.learning.options import parse_options
from maniskill_grpd.playing.agents import (
    Agent,
    AgentName,
    ExpertAgent,
    PlannerAgent,
    PolicyAgent,
    RandomAgent,
    Teleoperator,
    ZeroAgent,
)
from maniskill_grpd.playing.play_config import PlayConfig
from maniskill_grpd.runs.environments import make_env
from maniskill_grpd.trajectory.episode_recorder import EpisodeRecorder

REFUSALS = (ValueError, TypeError, OSError, CheckpointError, NonFiniteError)
"""What asked-for things raise that cannot be done: the asker is told, and the player goes on."""
MATERIAL = ("stretch", "bend", "mass", "friction", "damping")
"""Properties of the object that can be changed, as factors."""
IDLE_WAIT = 0.02
"""How long a paused player waits for somebody to ask for something [s]."""
LARGEST_LAG = 0.5
"""How far a player may fall behind real time before it gives up catching up [s]."""


class Watcher(Protocol):
    """Is told what happens, on the thread of the player."""

    def on_environment(self) -> None:
        """There is a new environment, which has just been reset."""

    def on_reset(self) -> None:
        """New episodes have started in the same environment."""

    def on_step(self) -> None:
        """A control step has been taken."""

    def on_idle(self) -> None:
        """Nothing happens: the player is paused."""

    def on_message(self, message: str) -> None:
        """Somebody has to be told something."""


@dataclass
class Moment:
    """The last step of all worlds."""

    graph: dict[str, Any]
    action: torch.Tensor | None = None
    """(B, D); None after a reset."""
    reward: torch.Tensor | None = None
    """(B,)."""
    success: torch.Tensor | None = None
    """(B,) bool."""
    step: int = 0
    """Steps of the present episodes."""


@dataclass
class Changes:
    """What was changed by hand, and is changed again after every reset."""

    material: dict[str, float] = field(default_factory=dict)
    """Factors on the material of the model."""
    gravity: float | None = None
    """Strength [m/s^2]."""
    noise: float = 0.0
    """Standard deviation of what policies see [m], [m/s]."""


class Player:
    """Plays a task. All methods but `ask` and `stop` belong to the thread that calls `run`.

    Args:
        config: Options.
        env: An environment to play in, which is not closed; one is made for the options by default.

    Raises:
        ValueError: If the task, an option or the agent does not exist, or the environment has no graph observations.
        CheckpointError: If the checkpoint is none, or its policy was trained on other observations.
    """

    def __init__(self, config: PlayConfig, env: gym.Env | None = None) -> None:
        self.config = config
        self.task = config.task() if env is None else TrainConfig(env_id=env.unwrapped.spec.id)
        self.seed = config.seed
        self.checkpoint = config.checkpoint
        self.changes = Changes()
        self.watchers: list[Watcher] = []
        self.is_playing, self.repeats, self.speed = True, True, 1.0
        self.recorder: EpisodeRecorder | None = None
        self._asked: queue.SimpleQueue[Callable[[], object]] = queue.SimpleQueue()
        self._is_stopped, self._next_time = False, 0.0
        self.agent_name: AgentName = config.first_agent
        self._given = env
        if env is None:
            self.env, self.agent = self._make(self.task, self.agent_name, self.checkpoint)
        else:
            self.env = _flattened(env)
            self.env.reset(seed=self.seed)
            self.agent = self._make_agent(self.env, self.task, self.agent_name, self.checkpoint)
        self.moment = self._first_moment()

    # ------------------------------------------------------------------ for all threads

    def ask(self, what: Callable[[], object]) -> None:
        """Have something done by the player between two steps; if it cannot be done, all are told why."""
        self._asked.put(what)

    def stop(self) -> None:
        """End `run` after the present step."""
        self._asked.put(self._end)

    # ------------------------------------------------------------------ the thread of the player

    @property
    def base(self) -> Any:
        """The environment itself."""
        return self.env.unwrapped

    def run(self) -> None:
        """Play until `stop`, at the chosen speed."""
        self._next_time = time.monotonic()
        while not self._is_stopped:
            if self.is_playing:
                self._advance()
                self._wait(self._next_time)
            else:
                self._wait(time.monotonic() + IDLE_WAIT)
                self._next_time = time.monotonic()
                self._notify("on_idle")

    def obey(self) -> None:
        """Do what was asked for, without waiting."""
        for _ in range(self._asked.qsize()):
            self._try(self._asked.get_nowait())

    def step(self) -> None:
        """Take one control step; new episodes follow where one has ended, if that is wanted."""
        if self._is_over and self.repeats:
            self.reset(self.seed + self.base.num_envs)
            return
        action = self.agent.act(self.moment.graph)
        obs, reward, _, truncated, info = self.env.step(action)
        self._is_over = bool(torch.as_tensor(truncated).all())
        self.moment = Moment(obs["graph"], action, reward, info["success"], self.moment.step + 1)
        self._notify("on_step")

    def reset(self, seed: int | None = None) -> None:
        """Start new episodes: from a seed, or from the present one again. What was changed by hand stays changed."""
        self.seed = self.seed if seed is None else _checked_seed(seed)
        if self.recorder is not None:
            self.recorder.drop()
        self.moment = self._first_moment()
        self._notify("on_reset")

    def choose_agent(self, name: AgentName, checkpoint: Path | None = None) -> None:
        """Let somebody else act from now on; the episode goes on. If that is not possible the present one goes on acting."""
        path = checkpoint or self.checkpoint
        self.agent = self._make_agent(self.env, self.task, name, path)
        self.agent_name, self.checkpoint = name, path
        self.set_noise(self.changes.noise)

    def change_options(self, env_kwargs: tuple[str, ...]) -> None:
        """Make the task anew with other options; if it does not take them the present one stays."""
        parse_options("env_kwargs", env_kwargs)
        self._replace(TrainConfig(env_id=self.task.env_id, env_kwargs=env_kwargs, sim_backend=self.task.sim_backend))

    def set_material(self, name: str, factor: float) -> None:
        """Change a property of the object, as a factor on that of its model, in all worlds at once."""
        if name not in MATERIAL:
            raise ValueError(f"material has {', '.join(MATERIAL)}, got {name!r}")
        self.base.solver.set_material(self._worlds(), **{name: float(factor)})
        self.changes.material[name] = float(factor)

    def set_gravity(self, strength: float) -> None:
        """Change the strength of gravity [m/s^2], in all worlds at once; its direction stays."""
        if not 0.0 <= strength <= 100.0:
            raise ValueError(f"gravity must be in [0, 100] m/s^2, got {strength}")
        self.base.solver.gravity[:] = -float(strength) * self._up
        self.changes.gravity = float(strength)

    def set_noise(self, sigma: float) -> None:
        """Change the noise through which policies see."""
        if isinstance(self.agent, PolicyAgent):
            self.agent.set_noise(float(sigma))
        elif sigma:
            self.tell(f"{self.agent_name} does not look at observations: noise is for policies")
        self.changes.noise = float(sigma)

    def start_recording(self) -> None:
        """Record what is done by hand from now on, in ManiSkill's format, from new episodes on."""
        if self.recorder is None:
            self._replace(self.task, is_recorded=True)

    def keep_episode(self) -> None:
        """Write the episode of the world that is tele-operated, and start the next."""
        if self.recorder is None:
            raise ValueError("nothing is being recorded")
        if self.moment.step == 0:
            raise ValueError("the episode has no steps yet")
        world = self.agent.world if isinstance(self.agent, Teleoperator) else 0
        self.recorder.keep(torch.tensor([world]).numpy())
        self.tell(f"kept an episode of {self.moment.step} steps in {self.recorder.path}")
        self.reset(self.seed + self.base.num_envs)

    def stop_recording(self) -> None:
        """Close the file of the recording."""
        if self.recorder is not None:
            path = self.recorder.path
            self._replace(self.task)
            self.tell(f"{path} is written")

    def tell(self, message: str) -> None:
        """Tell all who look, and the terminal."""
        print(message, file=sys.stderr)
        self._notify("on_message", message)

    def close(self) -> None:
        """Close the environment, and the file of a recording."""
        if self._given is None:
            self.env.close()

    # ------------------------------------------------------------------

    def _advance(self) -> None:
        self._next_time += self.base.control_timestep / self.speed if self.speed else 0.0
        self._next_time = max(self._next_time, time.monotonic() - LARGEST_LAG)
        try:
            self.step()
        except REFUSALS as error:
            self.is_playing = False
            self.tell(f"paused: {error}")

    def _wait(self, until: float) -> None:
        """Do what is asked for until a time, at least what waits already."""
        self.obey()
        while not self._is_stopped and (rest := until - time.monotonic()) > 0.0:
            with contextlib.suppress(queue.Empty):
                self._try(self._asked.get(timeout=rest))

    def _try(self, what: Callable[[], object]) -> None:
        try:
            what()
        except REFUSALS as error:
            self.tell(f"not done: {error}")

    def _end(self) -> None:
        self._is_stopped = True

    def _notify(self, event: str, *arguments: object) -> None:
        for watcher in self.watchers:
            getattr(watcher, event)(*arguments)

    def _make(
        self, task: TrainConfig, agent: AgentName, checkpoint: Path | None, *, is_recorded: bool = False
    ) -> tuple[gym.Env, Agent]:
        env = _flattened(make_env(task, self.config.num_envs))
        if is_recorded:
            env = self._recorded(env, task)
        env.reset(seed=self.seed)
        return env, self._make_agent(env, task, agent, checkpoint)

    def _recorded(self, env: gym.Env, task: TrainConfig) -> EpisodeRecorder:
        folder = self.config.demonstrations or Path("demos") / task.env_id
        name = next(name for number in range(10**6) if not (folder / f"{(name := f'teleop_{number}')}.h5").exists())
        settings = {"save_video": False, "save_on_reset": False, "source_type": "human", "source_desc": "tele-operation"}
        return EpisodeRecorder(env, folder, trajectory_name=name, **settings)

    def _make_agent(self, env: gym.Env, task: TrainConfig, name: AgentName, checkpoint: Path | None) -> Agent:
        if name == "policy":
            if checkpoint is None:
                raise ValueError("choose a checkpoint: there is no policy yet")
            return PolicyAgent(checkpoint, env, allow_import=self.config.allow_import)
        if name == "expert":
            return ExpertAgent(task.env_id, env)
        if name == "planner":
            return PlannerAgent(task, env)
        makers = {"random": RandomAgent, "zero": ZeroAgent, "teleop": Teleoperator}
        if name not in makers:
            raise ValueError(f"agents are policy, expert, planner, {', '.join(makers)}, got {name!r}")
        return makers[name](env)

    def _replace(self, task: TrainConfig, *, is_recorded: bool = False) -> None:
        """Exchange the environment; if the new one cannot be made the old one stays."""
        if self._given is not None:
            raise ValueError("this environment was given to the viewer: make another one, with other options, for another viewer")
        env, agent = self._make(task, self.agent_name, self.checkpoint, is_recorded=is_recorded)
        self.env.close()
        self.task, self.env, self.agent = task, env, agent
        self.recorder = env if isinstance(env, EpisodeRecorder) else None
        self.moment = self._first_moment()
        self._notify("on_environment")

    def _first_moment(self) -> Moment:
        seeds = list(range(self.seed, self.seed + self.base.num_envs))
        obs, _ = self.env.reset(seed=seeds)
        if isinstance(self.agent, PlannerAgent):
            self.agent.begin(seeds)
        gravity = self.base.solver.gravity
        self._up = -gravity / torch.linalg.vector_norm(gravity, dim=-1, keepdim=True)
        self._is_over = False
        for name, factor in self.changes.material.items():
            self.set_material(name, factor)
        if self.changes.gravity is not None:
            self.set_gravity(self.changes.gravity)
        if self.changes.noise and isinstance(self.agent, PolicyAgent):
            self.agent.set_noise(self.changes.noise)
        return Moment(obs["graph"])

    def _worlds(self) -> torch.Tensor:
        return torch.arange(self.base.num_envs, device=self.base.device)


def _flattened(env: gym.Env) -> gym.Env:
    """Return an environment whose actions are tensors: those of several agents side by side.

    Raises:
        ValueError: If there are no graphs in its observations.
    """
    if not getattr(env.unwrapped, "_has_graph", False):
        raise ValueError('the viewer needs graph observations: obs_mode="graph", or others joined with it')
    return FlattenActionSpaceWrapper(env) if isinstance(env.action_space, gym.spaces.Dict) else env


def _checked_seed(seed: int) -> int:
    if not 0 <= int(seed) < 2**31:
        raise ValueError(f"seed must be in [0, 2**31), got {seed}")
    return int(seed)
