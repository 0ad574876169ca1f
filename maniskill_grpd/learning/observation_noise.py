"""Gaussian noise on the observed positions and velocities of a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from maniskill_grpd.graphs.schema import NODE_TYPES, GraphSchema, NodeSchema


@dataclass(frozen=True, kw_only=True)
class ObservationNoise:
    """Disturbs what a sensor would measure, and everything that is computed from it.

    Each node's position moves by position_std e, e ~ N(0, I). Offsets from the node to something
    (vector channels in metres) move the other way, and a distance `x_distance` changes by as much as
    the length of `x_offset` does: it may be measured from elsewhere, such as from the surface of what
    the offset leads to. Velocities (vector channels in m/s) get noise of their own.

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
        moved = self.position_std * _normal(nodes["position"], generator)
        vectors, scalars = nodes["vectors"].clone(), nodes["scalars"].clone()
        names = {channel.name: place for place, channel in enumerate(schema.scalars)}
        for place, channel in enumerate(schema.vectors):
            if channel.unit == "m/s":
                vectors[..., place, :] += self.velocity_std * _normal(moved, generator)
            elif channel.unit == "m":
                vectors[..., place, :] -= moved
                distance = names.get(channel.name.removesuffix("_offset") + "_distance")
                if distance is not None:
                    longer = vectors[..., place, :].norm(dim=-1) - nodes["vectors"][..., place, :].norm(dim=-1)
                    scalars[..., distance].add_(longer).clamp_(min=0.0)
        return {**nodes, "position": nodes["position"] + moved, "vectors": vectors, "scalars": scalars}


def _normal(like: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)
