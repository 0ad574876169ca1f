"""One node type made of two."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from maniskill_grpd.graphs import GraphSchema, NodeSchema
from maniskill_grpd.graphs.schema import NODE_TYPES


class MergedNodes:
    """Puts objects and actuators into one list, as homogeneous networks see them.

    Nodes have the channels of both types, matched by name, with zeros where a type lacks one, and
    two more scalars: the type as one-hot (eq. 42, 43). Object nodes come first.

    Shapes: (B, N, ...) and (B, A, ...) -> (B, N + A, ...).
    Symmetry: none is touched; channels stay vectors or scalars.

    Attributes:
        num_vectors: Vector channels of a merged node.
        num_scalars: Scalar channels of a merged node, type included.

    Args:
        schema: What the graphs hold.
    """

    def __init__(self, schema: GraphSchema) -> None:
        self._sources = {kind: _sources(schema.object, schema.actuator, kind) for kind in ("vectors", "scalars")}
        self.num_vectors = len(self._sources["vectors"]["object"])
        self.num_scalars = len(self._sources["scalars"]["object"]) + len(NODE_TYPES)

    def __call__(self, graph: Mapping[str, Any]) -> dict[str, torch.Tensor]:
        """Merge the nodes of a normalised graph into position, vectors, scalars and mask."""
        parts = [self._widen(graph[node_type], node_type) for node_type in NODE_TYPES]
        return {key: torch.cat([part[key] for part in parts], dim=1) for key in parts[0]}

    def _widen(self, nodes: Mapping[str, torch.Tensor], node_type: str) -> dict[str, torch.Tensor]:
        wide = {"position": nodes["position"], "mask": nodes["mask"]}
        for kind, sources in self._sources.items():
            channels = nodes[kind]
            absent = torch.zeros_like(channels[:, :, :1]).sum(2)
            columns = [channels[:, :, i] if i >= 0 else absent for i in sources[node_type]]
            if kind == "scalars":
                columns += [absent + float(node_type == other) for other in NODE_TYPES]
            shape = (*channels.shape[:2], 0, *channels.shape[3:])
            wide[kind] = torch.stack(columns, 2) if columns else channels.new_zeros(shape)
        return wide


def _sources(objects: NodeSchema, actuators: NodeSchema, kind: str) -> dict[str, list[int]]:
    """Index of every channel of either type within each type, -1 where it lacks the channel."""
    names = {
        "object": [channel.name for channel in getattr(objects, kind)],
        "actuator": [channel.name for channel in getattr(actuators, kind)],
    }
    union = list(dict.fromkeys(names["object"] + names["actuator"]))
    return {node_type: [own.index(name) if name in own else -1 for name in union] for node_type, own in names.items()}
