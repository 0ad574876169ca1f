"""A planner where policies are played."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import torch

from maniskill_grpd.planning.planner import Planner


class PlanningActor:
    """A planner that is asked as a policy is; it looks at the state of the simulation and not at the graph."""

    def __init__(self, planner: Planner, env: gym.Env) -> None:
        """Plan for the E worlds of `env`, which are those of the episodes and not of the planner."""
        self._planner = planner
        self._env = env.unwrapped

    def act(self, graph: Any, **_: Any) -> torch.Tensor:
        """Return the actions for the present state of all worlds."""
        return self._planner.act(self._env.get_state_dict())
