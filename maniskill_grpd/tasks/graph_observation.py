"""The observation graph, built from the state of the solver."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.physics import Model, Solver
from maniskill_grpd.tasks.graph_nodes import choose_graph_nodes, neighbors_along

CONTACT_DISTANCE = 1.5
"""Nodes count as touching the table when their centre is closer to it than this many radii."""


class GraphObservation:
    """Builds `obs["graph"]` of all worlds.

    It fills the channels that all tasks have in common; a task adds the values of its own.

    Attributes:
        schema: What the graph holds.
    """

    def __init__(
        self,
        solver: Solver,
        gripper_nodes: torch.Tensor,
        object_channels: tuple[Channel, ...],
        gripper_channels: tuple[Channel, ...],
        num_nodes: int | None,
    ) -> None:
        """Set up what does not change between steps.

        Args:
            solver: The worlds; read at every `build`.
            gripper_nodes: Node that each gripper holds, (A,) int64.
            object_channels: Channels of the object's nodes.
            gripper_channels: Channels of the grippers.
            num_nodes: Number of object nodes in the graph; all for None.

        Raises:
            ValueError: If `num_nodes` is out of its range.
        """
        self._solver = solver
        self._radius = solver.model.radius
        nodes = choose_graph_nodes(solver.model, num_nodes, gripper_nodes.cpu().numpy())
        self._prepare_constants(solver.model, nodes, gripper_nodes)
        spacing = (
            float(solver.model.rest_lengths.mean())
            * (solver.model.num_nodes - 1)
            / (len(nodes) - 1)
        )
        self.schema = GraphSchema(
            object=_node_schema(object_channels),
            actuator=_node_schema(gripper_channels),
            length_scale=solver.model.length,
            edge_length=spacing,
        )

    def build(
        self,
        gripper_velocities: torch.Tensor,
        object_values: dict[str, torch.Tensor],
        gripper_values: dict[str, torch.Tensor],
    ) -> dict[str, Any]:
        """Return the graph of the current state, as copies.

        Args:
            gripper_velocities: (B, A, 3) [m/s].
            object_values: The task's own channels by name: vectors (B, N, 3), scalars (B, N).
            gripper_values: The same for the grippers, (B, A, 3) and (B, A).
        """
        solver = self._solver
        object_values = self._common_object_values() | object_values
        nodes = _stack_channels(solver.positions, object_values, self.schema.object)
        if self._nodes is not None:
            nodes = {key: value[:, self._nodes] for key, value in nodes.items()}
        nodes["neighbors"] = self._neighbors.clone()
        common = {
            "velocity": gripper_velocities,
            "arc": self._gripper_arc,
            "gripper_status": self._closed,
        }
        grippers = _stack_channels(
            solver.gripper_positions, common | gripper_values, self.schema.actuator
        )
        return {"object": nodes, "actuator": grippers, "gravity": solver.gravity.clone()}

    def _prepare_constants(
        self, model: Model, nodes: np.ndarray, gripper_nodes: torch.Tensor
    ) -> None:
        device, num_worlds = self._solver.device, self._solver.num_worlds
        self._nodes = (
            None if len(nodes) == model.num_nodes else torch.as_tensor(nodes, device=device)
        )
        neighbors = torch.as_tensor(neighbors_along(model, nodes), device=device)
        self._neighbors = neighbors.expand(num_worlds, -1, -1)
        arc = torch.as_tensor(np.abs(2.0 * model.arc - 1.0), dtype=torch.float32, device=device)
        self._arc = arc.expand(num_worlds, -1)
        self._gripper_arc = arc[gripper_nodes].expand(num_worlds, -1)
        self._closed = torch.ones_like(self._gripper_arc)

    def _common_object_values(self) -> dict[str, torch.Tensor]:
        solver = self._solver
        height = (solver.positions * solver.plane[:, None, :3]).sum(-1) - solver.plane[:, 3:]
        return {
            "velocity": solver.velocities,
            "arc": self._arc,
            "held": (solver.holder >= 0).float(),
            "contact": (height < CONTACT_DISTANCE * self._radius).float(),
        }


def _node_schema(all_channels: tuple[Channel, ...]) -> NodeSchema:
    """Sort channels by kind."""
    return NodeSchema(
        vectors=tuple(channel for channel in all_channels if channel.kind == "vector"),
        scalars=tuple(channel for channel in all_channels if channel.kind == "scalar"),
    )


def _stack_channels(
    positions: torch.Tensor, values: dict[str, torch.Tensor], schema: NodeSchema
) -> dict[str, torch.Tensor]:
    """Stack named channels of n nodes in the order of a schema; everything is copied."""
    return {
        "position": positions.clone(),
        "vectors": torch.stack([values[channel.name] for channel in schema.vectors], dim=2),
        "scalars": torch.stack([values[channel.name] for channel in schema.scalars], dim=2),
        "mask": positions.new_ones(positions.shape[:2], dtype=torch.bool),
    }
