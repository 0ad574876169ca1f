"""Worlds that are observed as graphs."""

from __future__ import annotations

from typing import Any

import torch

from maniskill_grpd.agents import GripperAgent
from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.tasks.measurement import Measurement
from maniskill_grpd.tasks.observation.graph_observation import GraphObservation
from maniskill_grpd.tasks.worlds.measured_worlds import MeasuredWorlds


class ObservedWorlds(MeasuredWorlds):
    """The part of an environment that adds a graph to ManiSkill's observations, and the nodes to its states."""

    graph_schema: GraphSchema
    """What `obs["graph"]` holds."""
    start_nodes: torch.Tensor
    """Node that each gripper held at the start of the episode, (B, A) int64."""
    _agents: list[GripperAgent]
    _graph: GraphObservation
    _has_graph: bool
    _full_obs_mode: str

    def object_values(self, measurement: Measurement) -> dict[str, torch.Tensor]:
        """Return the task's own channels of the object's nodes by name: vectors (B, N, 3), scalars (B, N); none by default."""
        return {}

    def gripper_values(self, measurement: Measurement) -> dict[str, torch.Tensor]:
        """Return the task's own channels of the grippers by name: vectors (B, A, 3), scalars (B, A); none by default."""
        return {}

    def goal_observations(self) -> dict[str, torch.Tensor]:
        """Return the goal as observation modes beside the graph show it, by name, (B, D); nothing by default."""
        return {}

    @property
    def obs_mode(self) -> str:
        """The observation mode, with the graph."""
        return self._full_obs_mode

    def get_obs(self, info: dict | None = None, unflattened: bool = False) -> Any:
        """Return the observation, as copies; `info` is what `get_info` returned for this state."""
        info = self.get_info() if info is None else info
        obs = super().get_obs(info, unflattened=unflattened)
        return _with_graph(obs, self._get_obs_graph()) if self._has_graph else obs

    def _flatten_raw_obs(self, obs: Any) -> Any:
        if not (self._has_graph and isinstance(obs, dict) and "graph" in obs):
            return super()._flatten_raw_obs(obs)
        graph = obs.pop("graph")
        return _with_graph(super()._flatten_raw_obs(obs), graph)

    def _get_obs_graph(self) -> dict[str, Any]:
        """Return the graph that `graph_schema` describes."""
        velocities = torch.cat([agent.robot.velocities for agent in self._agents], dim=1)
        measured = self.measurement
        return self._graph.build(self.start_nodes, velocities, self.object_values(measured), self.gripper_values(measured))

    def _get_obs_extra(self, info: dict) -> dict[str, torch.Tensor]:
        """Return the goal and, in observations of the state, where the nodes of the object are and how they move."""
        obs = {name: value.clone() for name, value in self.goal_observations().items()}
        if self.obs_mode_struct.use_state:
            kind = "rope" if self.solver.model.is_rope else "cloth"
            obs[f"{kind}_positions"] = self.solver.positions.flatten(1).clone()
            obs[f"{kind}_velocities"] = self.solver.velocities.flatten(1).clone()
        return obs


def _with_graph(obs: Any, graph: dict) -> dict:
    rest = obs if isinstance(obs, dict) else {"state": obs}
    return {**rest, "graph": graph}
