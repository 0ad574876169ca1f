"""Gaussian noise on the observed positions and velocities of a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch

from maniskill_grpd.graphs.displacement import displace
from maniskill_grpd.graphs.schema import NODE_TYPES, GraphSchema, NodeSchema


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


def _normal(like: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(like.shape, generator=generator, device=like.device, dtype=like.dtype)
