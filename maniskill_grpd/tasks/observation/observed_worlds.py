"""Worlds that are observed as graphs."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import torch

from maniskill_grpd.agents import GripperAgent
from maniskill_grpd.graphs import Channel, GraphSchema
from maniskill_grpd.tasks.measurement import Measurement
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.observation.graph_nodes import choose_graph_nodes, mean_spacing, neighbors_among
from maniskill_grpd.tasks.observation.graph_observation import GraphObservation
from maniskill_grpd.tasks.observation.keypoint_view import KeypointView
from maniskill_grpd.tasks.observation.node_statistics import mean_over_nodes
from maniskill_grpd.tasks.observation.partial_view import MaskedView, PartialView, Sight, StaleView
from maniskill_grpd.tasks.options.keypoints import choose_keypoints
from maniskill_grpd.tasks.options.visibility import check_critic_observations, choose_visibility
from maniskill_grpd.tasks.pictures.world_pictures import WorldPictures

GRAPH_FEATURES = ("paper", "rich")
"""What grippers may tell: themselves alone, as in eq. 43, or the goal and summaries of the whole object too."""


class ObservedWorlds(WorldPictures):
    """The part of an environment that adds a graph to ManiSkill's observations, and the nodes to its states.

    Args:
        obs_mode: ManiSkill's part of the observation mode.
        visibility: None (default): the graph shows all nodes; "camera": those that at least one of the task's cameras sees, which
            `sensor_configs` can move, and those that grippers hold.
        hidden_nodes: "mask" (default): the others are masked; "stale": they stay as they were last seen, with an age.
        keypoints: Number of nodes that the graph shows instead, found anew at every step among those that can be seen: corners
            or ends, and where the object is bent most.
        keypoint_noise: Standard deviation of their positions per axis [m].
        keypoint_dropout: Share of them in [0, 1) that is not found.
        critic_observations: "full": `graph["critic"]` holds the graph of all nodes, for the value function in training.
        settings: Those of the classes below.

    Raises:
        ValueError: If an option has a value that is not allowed, or options contradict each other.
    """

    OBJECT_CHANNELS: tuple[Channel, ...] = (channels.VELOCITY, channels.ARC, channels.HELD, channels.CONTACT)
    """What the object's nodes tell (eq. 42)."""
    GRIPPER_CHANNELS: tuple[Channel, ...] = (channels.VELOCITY, channels.GRIPPER_STATUS)
    """What grippers tell with `graph_features="paper"` (eq. 43)."""
    RICH_GRIPPER_CHANNELS: tuple[Channel, ...] | None = None
    """What they tell with `graph_features="rich"`; None for the same."""
    graph_schema: GraphSchema
    """What `obs["graph"]` holds."""
    graph_features: str
    """Which of the two graphs it is, one of `GRAPH_FEATURES`."""
    start_nodes: torch.Tensor
    """Node that each gripper held at the start of the episode, (B, A) int64."""
    _agents: list[GripperAgent]
    _graph: GraphObservation
    _num_graph_nodes: int | None
    _has_graph: bool
    _sight: Sight | None
    _seen: torch.Tensor | None = None
    _partial_view: PartialView | None
    _full_obs_mode: str

    def __init__(
        self,
        *,
        obs_mode: str,
        visibility: str | None = None,
        hidden_nodes: str = "mask",
        keypoints: int | None = None,
        keypoint_noise: float = 0.0,
        keypoint_dropout: float = 0.0,
        critic_observations: str | None = None,
        **settings: Any,
    ) -> None:
        beside = obs_mode if self._has_graph else None
        self._visibility = choose_visibility(visibility, hidden_nodes, beside, self.graph_features)
        self._keypoints = choose_keypoints(
            keypoints,
            keypoint_noise,
            keypoint_dropout,
            has_graph=self._has_graph,
            hidden_nodes=hidden_nodes,
            graph_features=self.graph_features,
        )
        is_partial = self._visibility.by_camera or self._keypoints is not None
        self._critic_sees_all = check_critic_observations(critic_observations, is_partial=is_partial)
        super().__init__(obs_mode=obs_mode, **settings)

    def object_values(self, measurement: Measurement) -> dict[str, torch.Tensor]:
        """Return the task's own channels of the object's nodes by name: vectors (B, N, 3), scalars (B, N); none by default."""
        return {}

    def gripper_values(self, measurement: Measurement) -> dict[str, torch.Tensor]:
        """Return the task's own channels of the grippers by name: vectors (B, A, 3), scalars (B, A); none by default.

        Those of `RICH_GRIPPER_CHANNELS` alone are left out of the graph with `graph_features="paper"`.
        """
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

    def gripper_channels(self, features: str) -> tuple[Channel, ...]:
        """Return the channels of grippers in one of the two graphs, "paper" or "rich"."""
        is_rich = features == "rich" and self.RICH_GRIPPER_CHANNELS is not None
        return self.RICH_GRIPPER_CHANNELS if is_rich else self.GRIPPER_CHANNELS

    def _set_up_graph(self) -> None:
        """Choose nodes and channels, once the solver is there."""
        shown = (*self.OBJECT_CHANNELS, channels.AGE) if self._visibility.keeps_stale else self.OBJECT_CHANNELS
        told = self.gripper_channels(self.graph_features)
        self._untold = {channel.name for channel in self.gripper_channels("rich")} - {channel.name for channel in told}
        self._graph = GraphObservation(self.solver, self.candidate_gripper_nodes, shown, told, self._num_graph_nodes)
        self.graph_schema = self._graph.schema
        self._set_up_sight()
        self._set_up_view()

    def _get_obs_graph(self) -> dict[str, Any]:
        """Return the graph that `graph_schema` describes."""
        velocities = torch.cat([agent.robot.velocities for agent in self._agents], dim=1)
        measured = self.measurement
        grippers = {name: value for name, value in self.gripper_values(measured).items() if name not in self._untold}
        graph = self._graph.build(self.start_nodes, velocities, self.object_values(measured), grippers)
        if self._partial_view is None:
            return graph
        every = graph["object"]
        seen = every["mask"] if self._sight is None else self._graph.thinned(self._seen_nodes())
        shown = {**graph, "object": self._partial_view.show(every, seen)}
        return {**shown, "critic": graph} if self._critic_sees_all else shown

    def _set_up_sight(self) -> None:
        """Let the graph show what the cameras see, where that is wanted; `_graph` is there."""
        self._sight = None
        if self._visibility.by_camera:
            view, cameras = self._rasterized_cameras()
            self._sight = Sight(self.solver, view, list(cameras.values()))

    def _set_up_view(self) -> None:
        """Choose what the graph shows of what is seen."""
        graph, keypoints = self._graph, self._keypoints
        self._partial_view = MaskedView() if self._sight is not None else None
        if self._visibility.keeps_stale:
            self._partial_view = StaleView(graph.num_nodes, graph.schema, self.episode_tensor)
        if keypoints is not None:
            self._partial_view = KeypointView(
                self.solver, graph.nodes, graph.schema, graph.thinned, keypoints, self.observation_seeds
            )
            nodes = [choose_graph_nodes(model, keypoints.num, np.empty(0, np.int64)) for model in self.models]
            neighbors = [neighbors_among(model, chosen) for model, chosen in zip(self.models, nodes, strict=True)]
            spacing = mean_spacing(self.models, nodes, neighbors)
            self.graph_schema = dataclasses.replace(graph.schema, edge_length=spacing)

    def _seen_nodes(self) -> torch.Tensor:
        """Return which nodes are seen now, (B, N) bool; looked at once until the worlds change, like `measurement`."""
        if self._seen is None:
            self._seen = self._sight.seen()
        return self._seen

    def forget_measurement(self) -> None:
        """Also look at the worlds anew."""
        super().forget_measurement()
        self._seen = None

    def get_info(self) -> dict[str, torch.Tensor]:
        """Return also `hidden_share`, the share of nodes that are not seen, (B,), where `visibility` is "camera"."""
        info = super().get_info()
        if self._sight is not None:
            mask = self.solver.node_mask
            info["hidden_share"] = mean_over_nodes((~self._seen_nodes()).float(), mask)
        return info

    def _has_random_observations(self) -> bool:
        points = self._keypoints
        return super()._has_random_observations() or (points is not None and bool(points.noise or points.dropout))

    def _start_observing(self, worlds: torch.Tensor) -> None:
        """Begin to observe the episodes of some worlds (b,)."""
        super()._start_observing(worlds)
        if isinstance(self._partial_view, StaleView):
            self._partial_view.forget(worlds)

    def _after_simulation_step(self) -> None:
        if isinstance(self._partial_view, StaleView):
            self._partial_view.grow_older(self.control_timestep)

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
