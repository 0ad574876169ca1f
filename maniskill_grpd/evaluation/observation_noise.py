"""Noise on what a policy observes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from maniskill_grpd.graphs import GraphSchema, NodeSchema
from maniskill_grpd.policies import Policy

VELOCITY = "velocity"
OFFSET, DISTANCE = "_offset", "_distance"


class NoisyObserver:
    """A policy that sees positions and velocities through Gaussian noise (Section III.E).

    Every node, of the object and of the grippers, is seen displaced by its own noise. What a task tells as an offset from a node
    to something else (channels `*_offset`) is then seen from the displaced node, and the distance beside it (`*_distance`)
    changes with the length of that offset: no channel tells the true position. The noise is drawn anew at every step.

    Args:
        policy: The policy that acts.
        sigma: Standard deviation of each component, of positions [m] and of velocities [m/s].
        generator: Source of the noise, on the device of the observations.

    Raises:
        ValueError: If sigma is negative.
    """

    def __init__(self, policy: Policy, sigma: float, generator: torch.Generator) -> None:
        if not sigma >= 0.0:
            raise ValueError(f"sigma must not be negative, got {sigma}")
        self._policy = policy
        self._sigma = sigma
        self._generator = generator

    def act(
        self, graph: Mapping[str, Any], deterministic: bool = False, generator: torch.Generator | None = None
    ) -> torch.Tensor:
        """Choose actions as `Policy.act` does, on a noisy copy of the graph."""
        noisy = add_noise(graph, self._policy.schema, self._sigma, self._generator)
        return self._policy.act(noisy, deterministic=deterministic, generator=generator)


def add_noise(
    graph: Mapping[str, Any], schema: GraphSchema, sigma: float, generator: torch.Generator
) -> dict[str, Any]:
    """Return a copy of a graph with noise on the positions and velocities of its nodes.

    Args:
        graph: As `schema` describes it; left as it is.
        schema: Names the channels.
        sigma: Standard deviation of each component [m] and [m/s].
        generator: Source of the noise.
    """
    noisy = {name: _noisy_nodes(graph[name], schema.node(name), sigma, generator) for name in ("object", "actuator")}
    return {**graph, **noisy}


def _noisy_nodes(
    nodes: Mapping[str, torch.Tensor], schema: NodeSchema, sigma: float, generator: torch.Generator
) -> dict[str, torch.Tensor]:
    position = nodes["position"]
    displacement = sigma * _normal_like(position, generator)
    vectors, scalars = nodes["vectors"].clone(), nodes["scalars"].clone()
    scalar_names = [channel.name for channel in schema.scalars]
    for index, channel in enumerate(schema.vectors):
        if channel.name == VELOCITY:
            vectors[..., index, :] += sigma * _normal_like(position, generator)
        elif channel.name.endswith(OFFSET):
            vectors[..., index, :] -= displacement
            distance = channel.name.removesuffix(OFFSET) + DISTANCE
            if distance in scalar_names:
                longer = vectors[..., index, :].norm(dim=-1) - nodes["vectors"][..., index, :].norm(dim=-1)
                values = scalars[..., scalar_names.index(distance)]
                values.add_(longer).clamp_(min=0.0)
    return {**nodes, "position": position + displacement, "vectors": vectors, "scalars": scalars}


def _normal_like(values: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    return torch.randn(values.shape, generator=generator, dtype=values.dtype, device=values.device)
