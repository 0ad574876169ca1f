"""The observation graph, built from the state of the solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.physics import Model, Solver
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.observation.graph_nodes import choose_graph_nodes, mean_spacing, neighbors_among

CONTACT_DISTANCE = 1.5
"""Nodes count as touching the table when their centre is closer to it than this many radii."""


class GraphObservation:
    """Builds `obs["graph"]` of all worlds.

    It fills the channels that all tasks have in common; a task adds the values of its own. Graphs of
    different variants are padded to the largest, with a mask.

    Attributes:
        schema: What the graph holds.
        nodes: Which nodes of each variant it has.
    """

    def __init__(
        self,
        solver: Solver,
        keep: Callable[[Model], np.ndarray],
        object_channels: tuple[Channel, ...],
        gripper_channels: tuple[Channel, ...],
        num_nodes: int | None,
    ) -> None:
        """Set up what does not change between steps.

        Args:
            solver: The worlds; read at every `build`.
            keep: Returns the nodes of a model that a thinned graph always shows.
            object_channels: Channels of the object's nodes.
            gripper_channels: Channels of the grippers.
            num_nodes: Number of object nodes in the graph; all for None.

        Raises:
            ValueError: If `num_nodes` is out of its range.
        """
        self._solver = solver
        models = solver.models
        self.nodes = nodes = [choose_graph_nodes(model, num_nodes, keep(model)) for model in models]
        neighbors = [neighbors_among(model, chosen) for model, chosen in zip(models, nodes, strict=True)]
        self._tabulate(nodes, neighbors)
        self.schema = GraphSchema(
            object=_node_schema(object_channels),
            actuator=_node_schema(gripper_channels),
            length_scale=max(model.length for model in models),
            edge_length=mean_spacing(models, nodes, neighbors),
        )

    def build(
        self,
        start_nodes: torch.Tensor,
        gripper_velocities: torch.Tensor,
        object_values: dict[str, torch.Tensor],
        gripper_values: dict[str, torch.Tensor],
    ) -> dict[str, Any]:
        """Return the graph of the current state, as copies.

        Args:
            start_nodes: Node at which each gripper started, (B, A) int64.
            gripper_velocities: (B, A, 3) [m/s].
            object_values: The task's own channels by name: vectors (B, N, 3), scalars (B, N).
            gripper_values: The same for the grippers, (B, A, 3) and (B, A).

        Raises:
            ValueError: If a declared channel has no values, a value is not that of a declared channel, or one has a wrong shape.
        """
        solver, variants = self._solver, self._solver.variants.long()
        along = self._along[variants]
        nodes = _stack_channels("object", solver.positions, self._common_values(variants), object_values, self.schema.object)
        nodes = {key: self.thinned(value) for key, value in nodes.items()}
        nodes |= {"mask": self._mask[variants], "neighbors": self._neighbors[variants]}
        common = {
            channels.VELOCITY.name: gripper_velocities,
            self._place.name: along.gather(1, start_nodes),
            channels.GRIPPER_STATUS.name: solver.closed.float(),
        }
        grippers = _stack_channels("gripper", solver.gripper_positions, common, gripper_values, self.schema.actuator)
        grippers["mask"] = torch.ones_like(solver.closed)
        return {"object": nodes, "actuator": grippers, "gravity": solver.gravity.clone()}

    def thinned(self, values: torch.Tensor) -> torch.Tensor:
        """Return what the nodes of the graph have of values of all nodes, (B, N, ...) to (B, n, ...)."""
        if not self._is_thinned:
            return values
        rows = torch.arange(len(values), device=values.device)[:, None]
        return values[rows, self._nodes[self._solver.variants.long()]]

    @property
    def num_nodes(self) -> int:
        """Number of object nodes n in the graph, with padding."""
        return self._mask.shape[1]

    def _tabulate(self, nodes: list[np.ndarray], neighbors: list[np.ndarray]) -> None:
        """Set up tables of all M variants, padded to n nodes of K neighbours."""
        solver, count = self._solver, len(nodes)
        self._is_thinned = any(len(entry) < m.num_nodes for entry, m in zip(nodes, solver.models, strict=True))
        size = max(len(entry) for entry in nodes)
        width = max(entry.shape[1] for entry in neighbors)
        chosen, mask = np.zeros((count, size), np.int64), np.zeros((count, size), bool)
        padded = np.full((count, size, width), -1, np.int64)
        along = np.zeros((count, solver.num_nodes), np.float32)
        is_rope = solver.model.is_rope
        self._place = channels.ARC if is_rope else channels.CORNER  # how a node lies in the object, whatever its pose
        for index, model in enumerate(solver.models):
            num = len(nodes[index])
            chosen[index, :num], mask[index, :num] = nodes[index], True
            padded[index, :num, : neighbors[index].shape[1]] = neighbors[index]
            along[index, : model.num_nodes] = np.abs(2.0 * model.arc - 1.0) if is_rope else 1.0 - model.arc
        self._nodes, self._mask, self._neighbors, self._along = (
            torch.as_tensor(table, device=solver.device) for table in (chosen, mask, padded, along)
        )

    def _common_values(self, variants: torch.Tensor) -> dict[str, torch.Tensor]:
        solver = self._solver
        height = (solver.positions * solver.plane[:, None, :3]).sum(-1) - solver.plane[:, 3:]
        return {
            channels.VELOCITY.name: solver.velocities,
            self._place.name: self._along[variants],
            channels.HELD.name: (solver.holder >= 0).float(),
            channels.AGE.name: torch.zeros_like(height),
            channels.CONTACT.name: (height < CONTACT_DISTANCE * solver.model.radius).float(),
        }


def _node_schema(all_channels: tuple[Channel, ...]) -> NodeSchema:
    """Sort channels by kind."""
    return NodeSchema(
        vectors=tuple(channel for channel in all_channels if channel.kind == "vector"),
        scalars=tuple(channel for channel in all_channels if channel.kind == "scalar"),
    )


def _stack_channels(
    kind: str, positions: torch.Tensor, common: dict[str, torch.Tensor], own: dict[str, torch.Tensor], schema: NodeSchema
) -> dict[str, torch.Tensor]:
    """Stack named channels of n nodes in the order of a schema; everything is copied."""
    values, declared = common | own, (*schema.vectors, *schema.scalars)
    _check_names(kind, values, own, [channel.name for channel in declared])
    for channel in declared:
        shape = positions.shape if channel.kind == "vector" else positions.shape[:2]
        if values[channel.name].shape != shape:
            given = tuple(values[channel.name].shape)
            raise ValueError(f"{kind}_values()[{channel.name!r}] is a {channel.kind} and must be {tuple(shape)}, got {given}")
    return {
        "position": positions.clone(),
        "vectors": _stacked([values[channel.name] for channel in schema.vectors], positions),
        "scalars": _stacked([values[channel.name] for channel in schema.scalars], positions[..., 0]),
    }


def _stacked(values: list[torch.Tensor], like: torch.Tensor) -> torch.Tensor:
    return torch.stack(values, dim=2) if values else torch.empty_like(like)[:, :, None][:, :, :0]


def _check_names(kind: str, values: dict[str, torch.Tensor], own: dict[str, torch.Tensor], declared: list[str]) -> None:
    missing, unknown = [name for name in declared if name not in values], [name for name in own if name not in declared]
    if missing:
        raise ValueError(f"{kind.upper()}_CHANNELS declares {missing}, for which {kind}_values() returns nothing")
    if unknown:
        raise ValueError(f"{kind}_values() returns {unknown}, which {kind.upper()}_CHANNELS does not declare: {declared}")
