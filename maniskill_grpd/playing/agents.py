"""Who acts in the player."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, Protocol

import torch

from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.experts import make_expert
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.rollout import Graph
from maniskill_grpd.planning import PlannerOptions
from maniskill_grpd.planning.actor import PlanningActor
from maniskill_grpd.planning.episodes import make_planner
from maniskill_grpd.playing.action_layout import ActionLayout
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.checkpoints import check_schema, load_policy
from maniskill_grpd.runs.noisy_observer import NoisyObserver

AgentName = Literal["policy", "expert", "planner", "random", "zero", "teleop"]


class Agent(Protocol):
    """Acts in all worlds."""

    def act(self, graph: Graph) -> torch.Tensor:
        """Return actions (B, D) for the observed graphs of all worlds."""


class PolicyAgent:
    """The policy of a checkpoint; acts with the mean of its distribution.

    Args:
        path: The checkpoint.
        env: The environment.
        allow_import: Whether the id of its task may name a module, which is imported then.

    Raises:
        CheckpointError: If it is no checkpoint, or of a policy for other observations.
    """

    def __init__(self, path: Path, env: Any, *, allow_import: bool) -> None:
        self.policy, _ = load_policy(path, env.unwrapped.device, allow_import=allow_import)
        check_schema(self.policy, env)
        self._generator = torch.Generator(env.unwrapped.device).manual_seed(0)
        self._observer: Policy | NoisyObserver = self.policy

    def set_noise(self, sigma: float) -> None:
        """Let it see positions [m] and velocities [m/s] through noise of a standard deviation; ValueError if that is negative."""
        self._observer = NoisyObserver(self.policy, sigma, self._generator) if sigma else self.policy

    def act(self, graph: Graph) -> torch.Tensor:
        """See `Agent`."""
        return self._observer.act(graph, deterministic=True)


class ExpertAgent:
    """The scripted expert of a task, which looks at the simulation; ValueError if there is none."""

    def __init__(self, env_id: str, env: Any) -> None:
        self._expert = make_expert(env_id, env)

    def act(self, graph: Graph) -> torch.Tensor:
        """See `Agent`."""
        return self._expert.act()


class PlannerAgent:
    """Plans in worlds of its own, with the options that the command `plan` has by default; slower than real time.

    Args:
        task: Names the task and its options.
        env: The environment.

    Raises:
        ValueError: If the task cannot be planned in.
    """

    def __init__(self, task: TrainConfig, env: Any) -> None:
        self._planner = make_planner(task, env.unwrapped.num_envs, PlannerOptions())
        self._actor = PlanningActor(self._planner, env)

    def begin(self, seeds: Sequence[int]) -> None:
        """Begin new episodes, of these seeds."""
        self._planner.begin(seeds)

    def act(self, graph: Graph) -> torch.Tensor:
        """See `Agent`."""
        return self._actor.act(graph)


class RandomAgent:
    """Actions drawn uniformly from the action space."""

    def __init__(self, env: Any) -> None:
        device = env.unwrapped.device
        space = env.unwrapped.single_action_space if not hasattr(env, "single_action_space") else env.single_action_space
        self._low, self._high = (torch.as_tensor(bound, device=device) for bound in (space.low, space.high))
        self._count = env.unwrapped.num_envs
        self._generator = torch.Generator(device).manual_seed(0)

    def act(self, graph: Graph) -> torch.Tensor:
        """See `Agent`."""
        share = torch.rand(self._count, *self._low.shape, generator=self._generator, device=self._low.device)
        return self._low + share * (self._high - self._low)


class ZeroAgent:
    """Does not move."""

    def __init__(self, env: Any) -> None:
        self._layout = ActionLayout(env)

    def act(self, graph: Graph) -> torch.Tensor:
        """See `Agent`."""
        return self._layout.still()


class Teleoperator:
    """Moves the grippers of one world towards given points, at most as fast as they can; the other worlds stay still.

    Args:
        env: The environment.

    Raises:
        ValueError: If actions in its control mode do not move points.
    """

    def __init__(self, env: Any) -> None:
        self._layout = ActionLayout(env)
        if not self._layout.moves_points:
            raise ValueError(f"grippers cannot be moved by hand in control mode {self._layout.mode!r}; pd_ee_delta_pos can")
        self._solver = env.unwrapped.solver
        self.world = 0
        self.targets = self._solver.gripper_positions[0].clone()
        """Where the grippers are to be, (A, 3) [m]."""
        self.closed = self._solver.closed[0].clone()
        """Which are to be closed, (A,) bool."""

    @property
    def has_grip(self) -> bool:
        """Whether grippers can open."""
        return self._layout.has_grip

    def take_over(self, world: int) -> None:
        """Go on from where the grippers of a world are."""
        self.world = world
        self.targets = self._solver.gripper_positions[world].clone()
        self.closed = self._solver.closed[world].clone()

    def act(self, graph: Graph) -> torch.Tensor:
        """See `Agent`."""
        action = self._layout.still()
        ways = (self.targets - self._solver.gripper_positions[self.world]) / STEP_SIZE
        ways = ways / torch.linalg.vector_norm(ways, dim=-1, keepdim=True).clamp(min=1.0)
        for way, closed, start, end in zip(ways, self.closed, self._layout.starts, self._layout.ends, strict=True):
            action[self.world, start : start + 3] = way
            if self._layout.has_grip:
                action[self.world, end - 1] = 1.0 if closed else -1.0
        return action
