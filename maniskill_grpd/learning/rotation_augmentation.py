"""Transitions seen from other directions: what a policy without symmetry has to be taught."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

import torch

from maniskill_grpd.graphs.schema import NODE_TYPES
from maniskill_grpd.learning.rollout import Batch, Graph

Augmentation = Literal["none", "vertical", "full"]
"""By which rotations scenes are turned: about the vertical, or by any."""


def random_rotations(count: int, augmentation: Augmentation, generator: torch.Generator) -> torch.Tensor:
    """Draw rotations uniformly.

    Args:
        count: How many.
        augmentation: "vertical", about z by any angle, or "full".
        generator: Source of randomness, a CPU generator.

    Returns:
        Matrices (count, 3, 3), float32.
    """
    if augmentation == "vertical":
        angle = 2.0 * math.pi * torch.rand(count, generator=generator)
        quaternion = torch.stack([(angle / 2).cos(), *angle.new_zeros(2, count), (angle / 2).sin()], dim=-1)
    else:
        quaternion = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=-1)
    w, x, y, z = quaternion.unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        *(2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        *(2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))


def rotate_batch(batch: Batch, rotations: torch.Tensor) -> Batch:
    """Turn every transition about the origin of its world: positions, vectors and gravity, the action and the old policy's mean.

    Densities of actions, advantages and returns are those of the scene as it was: the tasks know no direction, and isotropic
    noise has the same density in all of them. That the old policy would have acted alike in the turned scene is true of
    equivariant policies, and of others as far as they have learned it.

    Args:
        batch: M transitions.
        rotations: Matrices (M, 3, 3).
    """
    rotations = rotations.to(batch.actions)
    tools = batch.old.mean.shape[1]
    actions = batch.actions.unflatten(1, (tools, -1))
    turned = torch.cat([_turn(actions[..., :3], rotations), actions[..., 3:]], dim=-1)
    old = dataclasses.replace(batch.old, mean=_turn(batch.old.mean, rotations))
    return dataclasses.replace(batch, graph=_rotate_graph(batch.graph, rotations), actions=turned.flatten(1), old=old)


def _rotate_graph(graph: Graph, rotations: torch.Tensor) -> Graph:
    turned = {**graph, "gravity": _turn(graph["gravity"], rotations)}
    for node_type in NODE_TYPES:
        nodes = graph[node_type]
        turned[node_type] = {**nodes, **{key: _turn(nodes[key], rotations) for key in ("position", "vectors")}}
    return turned


def _turn(vectors: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
    """Turn vectors (M, ..., 3) by matrices (M, 3, 3)."""
    return torch.einsum("m...j,mij->m...i", vectors, rotations)
