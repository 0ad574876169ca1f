"""What nodes would be observed as if they were elsewhere."""

from __future__ import annotations

from collections.abc import Mapping

import torch

from maniskill_grpd.graphs.schema import Channel, NodeSchema

SMALLEST_LENGTH = 1e-5
"""Shorter parts of vectors are rounding errors [m]."""


def displace(schema: NodeSchema, nodes: Mapping[str, torch.Tensor], shift: torch.Tensor) -> dict[str, torch.Tensor]:
    """Return nodes of a graph as they are observed after they have moved, as far as their channels say what moves them.

    Args:
        schema: What the nodes hold.
        nodes: One of the node types of a graph; not changed.
        shift: How far each node moves, (B, n, 3) [m].
    """
    before = dict(zip((channel.name for channel in schema.vectors), nodes["vectors"].unbind(2), strict=True))
    after = {channel.name: before[channel.name] + _vector_change(channel, before, shift) for channel in schema.vectors}
    scalars = [
        _moved_scalar(channel, value, before, after, shift)
        for channel, value in zip(schema.scalars, nodes["scalars"].unbind(2), strict=True)
    ]
    return {
        **nodes,
        "position": nodes["position"] + shift,
        "vectors": torch.stack([*after.values()], dim=2) if after else nodes["vectors"].clone(),
        "scalars": torch.stack(scalars, dim=2) if scalars else nodes["scalars"].clone(),
    }


def _vector_change(channel: Channel, vectors: Mapping[str, torch.Tensor], shift: torch.Tensor) -> torch.Tensor:
    change = torch.zeros_like(shift)
    if channel.starts_at == "node":
        change = change - shift
    if channel.ends_at == "partner":
        change = change + shift.flip(1)
    if channel.across is not None:
        axis = vectors[channel.across]
        # Beyond the end of what extends along the axis, the nearest point is that end, and stays.
        is_across = (vectors[channel.name] * axis).sum(-1, keepdim=True).abs() < SMALLEST_LENGTH
        change = change - is_across * (change * axis).sum(-1, keepdim=True) * axis
    return change


def _moved_scalar(
    channel: Channel,
    value: torch.Tensor,
    before: Mapping[str, torch.Tensor],
    after: Mapping[str, torch.Tensor],
    shift: torch.Tensor,
) -> torch.Tensor:
    if channel.distance_of is not None:
        longer = after[channel.distance_of].norm(dim=-1) - before[channel.distance_of].norm(dim=-1)
        return (value + longer).clamp(min=0.0)
    if channel.along is not None:
        return value + (shift * before[channel.along]).sum(-1)
    return value
