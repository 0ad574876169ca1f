"""What can be drawn over the worlds: the graph that policies see, and where grippers have been."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
import torch

from maniskill_grpd.learning.rollout import Graph, map_graph
from maniskill_grpd.physics import Solver
from maniskill_grpd.playing.agents import PolicyAgent
from maniskill_grpd.playing.player import Player
from maniskill_grpd.runs.inspection import node_sensitivity
from maniskill_grpd.tasks.pictures.world_parts import WorldParts

if TYPE_CHECKING:
    import viser

NODE_COLOR, EDGE_COLOR, TRAIL_COLOR = (40, 40, 60), (90, 90, 110), (60, 90, 200)
WEAK, STRONG = np.array([225.0, 225.0, 235.0]), np.array([200.0, 30.0, 30.0])
"""Colours of edges along which a policy hears nothing, and the most."""
NODE_SIZE, LINE_WIDTH = 0.012, 2.0
"""Size of nodes [m], width of lines [pixels]."""
SENSITIVITY_PERIOD = 5
"""Steps from one derivative of the policy to the next."""
TRAIL_LENGTH = 60
"""Steps that a trail shows."""


class GraphOverlay:
    """Nodes and edges of the observed graph; edges to actuators in the colour of the policy's sensitivity, |d a / d p|.

    Args:
        server: Where it is drawn.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._sensitivity: torch.Tensor | None = None
        self.is_on = False

    def show(self, player: Player, parts: WorldParts, world: int) -> None:
        """Draw the graph of all worlds shown, and the edges to the actuators of one, where it is on."""
        if not self.is_on:
            return
        graph = player.moment.graph
        points, lines = zip(*(self._world(graph, shown, parts.offset_of(shown)) for shown in parts.worlds), strict=True)
        add = self._server.scene
        add.add_point_cloud("/overlay/nodes", np.concatenate(points), NODE_COLOR, point_size=NODE_SIZE, point_shape="circle")
        width = {"thickness": LINE_WIDTH, "thickness_units": "screen"}
        add.add_line_segments("/overlay/mesh", np.concatenate(lines), EDGE_COLOR, **width)
        segments, colors = self._influence(player, world, parts.offset_of(world))
        add.add_line_segments("/overlay/influence", segments, colors, **width)

    def switch(self, is_on: bool) -> None:
        """Turn it on or off."""
        self.is_on = is_on
        if not is_on:
            self._server.scene.remove_by_name("/overlay")

    def _world(self, graph: Graph, world: int, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return points (n, 3) and segments (m, 2, 3) of one world."""
        nodes = graph["object"]
        present = nodes["mask"][world].cpu().numpy()
        points = (nodes["position"][world].cpu().numpy() + offset).astype(np.float32)
        first, column = np.nonzero(nodes["neighbors"][world].cpu().numpy() >= 0)
        second = nodes["neighbors"][world].cpu().numpy()[first, column]
        kept = (first < second) & present[first] & present[second]
        return points[present], np.stack([points[first[kept]], points[second[kept]]], axis=1)

    def _influence(self, player: Player, world: int, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the edges from nodes to actuators, (e, 2, 3), and their colours, (e, 2, 3) uint8."""
        graph = map_graph(lambda tensor: tensor[world : world + 1], player.moment.graph)
        nodes, actuators = (graph[kind]["position"][0].cpu().numpy() + offset for kind in ("object", "actuator"))
        segments = np.stack(np.broadcast_arrays(nodes[None], actuators[:, None]), axis=2)
        weights = self._weights(player, graph, segments.shape[:2])
        colors = WEAK + (STRONG - WEAK) * weights[..., None]
        order = np.argsort(weights.ravel())  # strong ones are drawn last
        colors = np.repeat(colors.reshape(-1, 1, 3), 2, axis=1)[order].astype(np.uint8)
        return segments.reshape(-1, 2, 3)[order].astype(np.float32), colors

    def _weights(self, player: Player, graph: Graph, shape: tuple[int, int]) -> np.ndarray:
        """Return how much each actuator hears from each node, as shares of the most, (A, N)."""
        if not isinstance(player.agent, PolicyAgent):
            return np.zeros(shape)
        if self._sensitivity is None or tuple(self._sensitivity.shape) != shape or player.moment.step % SENSITIVITY_PERIOD == 0:
            self._sensitivity = node_sensitivity(player.agent.policy, graph)
        return (self._sensitivity / self._sensitivity.max().clamp(min=1e-9)).cpu().numpy()


class Trails:
    """Where grippers have been in the last steps.

    Args:
        server: Where they are drawn.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._places: deque[np.ndarray] = deque(maxlen=TRAIL_LENGTH)
        self.is_on = False

    def show(self, solver: Solver, parts: WorldParts) -> None:
        """Take note of where grippers are, and draw the trails where they are on."""
        places = solver.gripper_positions[list(parts.worlds)].cpu().numpy() + parts.offsets[:, None]
        self._places.append(places.reshape(-1, 3).astype(np.float32))
        if self.is_on and len(self._places) > 1:
            places = np.stack(self._places)
            segments = np.stack([places[:-1], places[1:]], axis=2).reshape(-1, 2, 3)
            width = {"thickness": LINE_WIDTH, "thickness_units": "screen"}
            self._server.scene.add_line_segments("/trails", segments, TRAIL_COLOR, **width)

    def switch(self, is_on: bool) -> None:
        """Turn them on or off."""
        self.is_on = is_on
        if not is_on:
            self._server.scene.remove_by_name("/trails")

    def clear(self) -> None:
        """Forget where grippers have been."""
        self._places.clear()
