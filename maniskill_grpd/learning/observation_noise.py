"""Gaussian noise on the observed positions and velocities of a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from maniskill_grpd.graphs.schema import NODE_TYPES, Channel, GraphSchema, NodeSchema

SMALLEST_LENGTH = 1e-5
"""Shorter parts of vectors are rounding errors [m]."""


@dataclass(frozen=True, kw_only=True)
class ObservationNoise:
    """Disturbs what a sensor would measure, and everything that can be computed from it.

    Each node's position moves by d = position_std e, e ~ N(0, I), and every channel that says what moves it (`Channel.starts_at`
    and what follows there) becomes that of the moved nodes. Velocities (vector channels in m/s) get noise of their own. The
    other channels stay as they are: a policy sees them exactly.

    Attributes:
        schema: What the graphs hold.
        position_std: Standard deviation per axis [m].
        velocity_std: Standard deviation per axis [m/s].
    """

    schema: GraphSchema
    position_std: float
    velocity_std: float

    def __call__(self, graph: Mapping[str, Any], generator: torch.Generator) -> Mapping[str, Any]:
        """Return a disturbed copy of a raw graph.

        Args:
            graph: (B, ...) per tensor; not changed. Without noise it is returned as it is.
            generator: Source of the noise, on the device of the graph.
        """
        if not (self.position_std or self.velocity_std):
            return graph
        noisy = {name: self._disturb(self.schema.node(name), graph[name], generator) for name in NODE_TYPES}
        return {**graph, **noisy}

    def _disturb(
        self, schema: NodeSchema, nodes: Mapping[str, torch.Tensor], generator: torch.Generator
    ) -> dict[str, torch.Tensor]:
        shift = self.position_std * _normal(nodes["position"], generator)
        moved = displace(schema, nodes, shift)
        for place, channel in enumerate(schema.vectors):
            if channel.unit == "m/s":
                moved["vectors"][..., place, :] += self.velocity_std * _normal(shift, generator)
        return moved


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


def _normal(like: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)
