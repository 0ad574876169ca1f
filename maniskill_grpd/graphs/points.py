"""Observation graphs from point clouds, where there is no mesh."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch

from maniskill_grpd.graphs.schema import Channel, GraphSchema, NodeSchema

GRIPPER_STATUS = Channel("gripper_status", "scalar", "", "1 closed, eq. 43")


def point_schema(channels: Sequence[Channel] = (), *, length_scale: float, edge_length: float) -> GraphSchema:
    """Return what graphs of `points_to_graph` hold.

    Args:
        channels: What is known of each point beside its place; vectors and scalars in any order.
        length_scale: Size of the object [m].
        edge_length: Typical distance of neighbouring nodes [m].
    """
    kinds = ("vector", "scalar")
    vectors, scalars = (tuple(channel for channel in channels if channel.kind == kind) for kind in kinds)
    return GraphSchema(NodeSchema(vectors, scalars), NodeSchema((), (GRIPPER_STATUS,)), length_scale, edge_length)


def points_to_graph(
    points: torch.Tensor,
    mask: torch.Tensor,
    grippers: torch.Tensor,
    closed: torch.Tensor,
    gravity: torch.Tensor,
    *,
    schema: GraphSchema,
    num_nodes: int,
    num_neighbors: int = 6,
    values: Mapping[str, torch.Tensor] | None = None,
) -> dict[str, Any]:
    """Turn segmented point clouds into graphs: farthest points are nodes, the nearest of them are neighbours.

    The first node is the point farthest from the mean, so that the order of the points does not matter, and a cloud that is
    turned and moved gives the same graph, turned and moved. Where a cloud has fewer points than nodes the rest is masked.

    Args:
        points: (B, P, 3) [m], in the frame of each world.
        mask: Points that belong to the object, (B, P) bool; what the others are does not matter.
        grippers: Positions of the grippers, (B, A, 3) [m].
        closed: Grippers that are closed, (B, A) bool.
        gravity: (B, 3) [m/s^2].
        schema: What the graph holds, see `point_schema`.
        num_nodes: Number of nodes n, >= 2.
        num_neighbors: Largest number of neighbours K of a node, in [1, n); those farther than three times
            `schema.edge_length` are none.
        values: What is known of each point by the name of its channel: vectors (B, P, 3), scalars (B, P).

    Returns:
        A graph as `GraphSchema` describes it, with n nodes.

    Raises:
        ValueError: If a shape does not fit, a number is out of its range, a value is missing or unknown, or a point of the object
            is not finite.
    """
    values = values or {}
    _check(points, mask, num_nodes, num_neighbors, values, schema)
    chosen, is_node = _farthest_points(points, mask, num_nodes)
    rows = torch.arange(len(points), device=points.device)[:, None]

    def at_nodes(of_points: torch.Tensor) -> torch.Tensor:
        picked = of_points[rows, chosen]
        return torch.where(is_node.reshape(*is_node.shape, *[1] * (picked.ndim - 2)), picked, torch.zeros_like(picked))

    position = at_nodes(points)
    vectors, scalars = ([at_nodes(values[c.name]) for c in kind] for kind in (schema.object.vectors, schema.object.scalars))
    nodes = {
        "position": position,
        "vectors": torch.stack(vectors, dim=2) if vectors else position[:, :, None][:, :, :0],
        "scalars": torch.stack(scalars, dim=2) if scalars else position[..., :0],
        "mask": is_node,
        "neighbors": _nearest(position, is_node, num_neighbors, 3.0 * schema.edge_length),
    }
    actuators = {
        "position": grippers.clone(),
        "vectors": grippers[:, :, None][:, :, :0],
        "scalars": closed.to(grippers.dtype)[..., None],
        "mask": torch.ones_like(closed),
    }
    return {"object": nodes, "actuator": actuators, "gravity": gravity.clone()}


def _farthest_points(points: torch.Tensor, mask: torch.Tensor, num: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Return indices of points (B, num), each the farthest from those before, and which are points of the mask, (B, num)."""
    points = torch.where(mask[..., None], points, 0.0)
    mean = points.sum(dim=1, keepdim=True) / mask.sum(dim=1).clamp(min=1)[:, None, None]
    distance = torch.linalg.vector_norm(points - mean, dim=-1)
    rows = torch.arange(len(points), device=points.device)
    chosen = []
    for index in range(num):
        chosen.append(torch.where(mask, distance, -1.0).argmax(dim=1))
        away = torch.linalg.vector_norm(points - points[rows, chosen[-1]][:, None], dim=-1)
        distance = away if index == 0 else torch.minimum(distance, away)
    is_node = torch.arange(num, device=points.device) < mask.sum(dim=1, keepdim=True)
    return torch.stack(chosen, dim=1), is_node


def _nearest(position: torch.Tensor, mask: torch.Tensor, num: int, reach: float) -> torch.Tensor:
    """Return the nearest other nodes of each, nearest first, -1 for none within reach, (B, n, num) int64."""
    distance = torch.linalg.vector_norm(position[:, :, None] - position[:, None], dim=-1)
    own = torch.eye(position.shape[1], dtype=torch.bool, device=position.device)
    distance = distance.masked_fill(own | ~mask[:, None] | ~mask[:, :, None], torch.inf)
    nearest, order = distance.topk(num, largest=False, sorted=True)
    return torch.where(nearest <= reach, order, -1)


def _check(
    points: torch.Tensor,
    mask: torch.Tensor,
    num_nodes: int,
    num_neighbors: int,
    values: Mapping[str, torch.Tensor],
    schema: GraphSchema,
) -> None:
    if points.ndim != 3 or points.shape[2] != 3 or mask.shape != points.shape[:2] or mask.dtype != torch.bool:
        raise ValueError(f"points must be (B, P, 3) and mask (B, P) bool, got {tuple(points.shape)} and {tuple(mask.shape)}")
    if num_nodes < 2:
        raise ValueError(f"num_nodes must be >= 2, got {num_nodes}")
    if not 1 <= num_neighbors < num_nodes:
        raise ValueError(f"num_neighbors must be in [1, {num_nodes}), got {num_neighbors}")
    declared = [*schema.object.vectors, *schema.object.scalars]
    if set(values) != {channel.name for channel in declared}:
        raise ValueError(f"values must be those of {[channel.name for channel in declared]}, got {list(values)}")
    for channel in declared:
        shape = points.shape if channel.kind == "vector" else points.shape[:2]
        if values[channel.name].shape != shape:
            raise ValueError(f"{channel.name!r} must be {tuple(shape)}, got {tuple(values[channel.name].shape)}")
    if not bool(torch.isfinite(points[mask]).all()):
        raise ValueError("points of the object must be finite")
