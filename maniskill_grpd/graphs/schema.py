"""Names, kinds and units of the channels of an observation graph.

Letters used for shapes here and in the policies: B worlds or minibatch, N object nodes, A
actuators, K neighbours of a node, V vector channels, S scalar channels.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import torch

NODE_TYPES = ("object", "actuator")


@dataclass(frozen=True)
class Channel:
    """One input channel of a node.

    Attributes:
        name: Unique within its node type.
        kind: "vector" (rotates with the scene) or "scalar" (does not).
        unit: SI unit, "" when dimensionless.
        source: Where the channel comes from, for example "eq. 42".
        starts_at: "node" for vectors that lead from the node to something: they change by -d when the node moves by d.
        ends_at: "partner" for vectors that lead to the other one of two nodes: they change by +d when that one moves by d.
        across: Name of a unit vector channel of the same nodes, along which the something extends, like an axis: a vector that
            starts at the node leads to its nearest point, and only the part of d across it counts.
        along: Name of a unit vector channel: the scalar tells how far along it the node is.
        distance_of: Name of a vector channel whose length the scalar is; it may be measured from elsewhere, such as from the
            surface of what the vector leads to.

    A channel with none of these does not change when its node moves, or changes in a way that only the simulation can tell.
    """

    name: str
    kind: Literal["vector", "scalar"]
    unit: str
    source: str
    starts_at: Literal["node"] | None = None
    ends_at: Literal["partner"] | None = None
    across: str | None = None
    along: str | None = None
    distance_of: str | None = None

    def __post_init__(self) -> None:
        if self.kind not in ("vector", "scalar"):
            raise ValueError(f'kind of channel {self.name!r} must be "vector" or "scalar", got {self.kind!r}')
        for name, allowed in (("starts_at", "node"), ("ends_at", "partner")):
            if getattr(self, name) not in (None, allowed):
                raise ValueError(f"{name} of channel {self.name!r} must be {allowed!r} or None, got {getattr(self, name)!r}")
        of_vectors, of_scalars = (self.starts_at, self.ends_at, self.across), (self.along, self.distance_of)
        if any(of_scalars if self.kind == "vector" else of_vectors):
            raise ValueError(
                f"channel {self.name!r} is a {self.kind}: vectors take starts_at, ends_at and across, "
                "scalars along and distance_of"
            )

    @property
    def follows(self) -> tuple[str, ...]:
        """Names of the vector channels that this one is told by."""
        return tuple(name for name in (self.across, self.along, self.distance_of) if name is not None)


@dataclass(frozen=True)
class NodeSchema:
    """Channels of one node type, in the order in which they stand in the tensors (eq. 42, 43).

    Attributes:
        vectors: Channels of the tensor (B, nodes, V, 3).
        scalars: Channels of the tensor (B, nodes, S).
    """

    vectors: tuple[Channel, ...]
    scalars: tuple[Channel, ...]

    def __post_init__(self) -> None:
        for kind, channels in (("vector", self.vectors), ("scalar", self.scalars)):
            wrong = [channel.name for channel in channels if channel.kind != kind]
            if wrong:
                raise ValueError(f"channels {wrong} stand among the {kind}s but are of another kind")
            names = [channel.name for channel in channels]
            if len(set(names)) != len(names):
                raise ValueError(f"names of {kind} channels must be unique, got {names}")
        vectors = [channel.name for channel in self.vectors]
        for channel in (*self.vectors, *self.scalars):
            unknown = [name for name in channel.follows if name not in vectors]
            if unknown:
                raise ValueError(f"channel {channel.name!r} follows {unknown}, which are not among the vectors {vectors}")

    @property
    def num_vectors(self) -> int:
        """Number of vector channels V."""
        return len(self.vectors)

    @property
    def num_scalars(self) -> int:
        """Number of scalar channels S."""
        return len(self.scalars)


@dataclass(frozen=True)
class GraphSchema:
    """What an observation graph holds; all a policy needs to know about a task.

    A graph is a nest of tensors:

        graph["object"]    position (B, N, 3) [m], vectors (B, N, V, 3), scalars (B, N, S),
                           mask (B, N) bool, neighbors (B, N, K) int64 (-1: no neighbour)
        graph["actuator"]  position (B, A, 3) [m], vectors (B, A, V, 3), scalars (B, A, S),
                           mask (B, A) bool
        graph["gravity"]   (B, 3) [m/s^2]
        graph["critic"]    in training only, where the value function sees more: another such graph, perhaps of more nodes

    Actuator-actuator and object-actuator edges are complete and implicit (eq. 36-41).

    Attributes:
        object: Channels of the nodes of the deformable object.
        actuator: Channels of the grippers.
        length_scale: Size of the object [m]; the unit of long-range distances.
        edge_length: Typical length of a mesh edge [m]; the unit of distances between neighbours.
    """

    object: NodeSchema
    actuator: NodeSchema
    length_scale: float
    edge_length: float

    def __post_init__(self) -> None:
        for name in ("length_scale", "edge_length"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be positive [m], got {getattr(self, name)}")

    def node(self, node_type: str) -> NodeSchema:
        """Channels of "object" or "actuator"."""
        return {"object": self.object, "actuator": self.actuator}[node_type]

    def validate(self, graph: Mapping[str, Any], *, values: bool = False) -> None:
        """Check names, shapes and dtypes of a graph.

        Args:
            graph: The graph to check.
            values: Also check that neighbours are in [-1, N) and numbers finite. Costs a host
                synchronisation on CUDA, therefore off by default.

        Raises:
            ValueError: Naming what was expected and what was given, for the first mismatch.
        """
        for node_type in NODE_TYPES:
            if node_type not in graph:
                raise ValueError(f"graph must have the keys {[*NODE_TYPES, 'gravity']}, got {sorted(graph)}")
        if "gravity" not in graph:
            raise ValueError("graph must have the key 'gravity' (B, 3) [m/s^2]")
        batch = _shape(graph["object"], "object", "position")[0]
        _expect_shape("gravity", graph["gravity"], (batch, 3))
        _expect_dtype("gravity", graph["gravity"], "floating point")
        for node_type in NODE_TYPES:
            _validate_nodes(graph[node_type], node_type, self.node(node_type), batch)
        _validate_neighbors(graph["object"])
        if values:
            _validate_values(graph)
        if "critic" in graph:
            self.validate(graph["critic"], values=values)

    def to_dict(self) -> dict[str, Any]:
        """Plain python types, fit for a checkpoint or JSON."""
        plain = asdict(self)
        for node_type in NODE_TYPES:
            plain[node_type] = {kind: list(channels) for kind, channels in plain[node_type].items()}
        return plain

    @classmethod
    def from_dict(cls, plain: Mapping[str, Any]) -> GraphSchema:
        """Inverse of `to_dict`."""
        nodes = {
            node_type: NodeSchema(
                vectors=tuple(Channel(**channel) for channel in plain[node_type]["vectors"]),
                scalars=tuple(Channel(**channel) for channel in plain[node_type]["scalars"]),
            )
            for node_type in NODE_TYPES
        }
        return cls(**nodes, length_scale=float(plain["length_scale"]), edge_length=float(plain["edge_length"]))

    def describe(self) -> str:
        """Human-readable table of all channels."""
        rows = [("node", "kind", "index", "channel", "unit", "source")]
        for node_type in NODE_TYPES:
            node = self.node(node_type)
            for channels in (node.vectors, node.scalars):
                rows += [(node_type, c.kind, str(i), c.name, c.unit or "-", c.source) for i, c in enumerate(channels)]
        rows.append(("graph", "vector", "-", "gravity", "m/s^2", "design"))
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in rows]
        lines.insert(1, "  ".join("-" * width for width in widths))
        lines.append(f"length_scale {self.length_scale:g} m, edge_length {self.edge_length:g} m")
        return "\n".join(lines)


def _validate_nodes(nodes: Mapping[str, torch.Tensor], node_type: str, schema: NodeSchema, batch: int) -> None:
    shape = _shape(nodes, node_type, "position")
    count = shape[1] if len(shape) > 1 else -1
    expected = {
        "position": ((batch, count, 3), "floating point"),
        "vectors": ((batch, count, schema.num_vectors, 3), "floating point"),
        "scalars": ((batch, count, schema.num_scalars), "floating point"),
        "mask": ((batch, count), "bool"),
    }
    channels = {"vectors": schema.vectors, "scalars": schema.scalars}
    for key, (expected_shape, dtype) in expected.items():
        _shape(nodes, node_type, key)
        _expect_shape(f"{node_type}.{key}", nodes[key], expected_shape, channels.get(key, ()))
        _expect_dtype(f"{node_type}.{key}", nodes[key], dtype)


def _validate_neighbors(nodes: Mapping[str, torch.Tensor]) -> None:
    shape = _shape(nodes, "object", "neighbors")
    batch, count = nodes["position"].shape[:2]
    last = shape[2] if len(shape) > 2 else -1
    _expect_shape("object.neighbors", nodes["neighbors"], (batch, count, last))
    _expect_dtype("object.neighbors", nodes["neighbors"], "int64")
    if last < 1:
        raise ValueError("object.neighbors must have at least one column, of -1 without neighbours")


def _validate_values(graph: Mapping[str, Any]) -> None:
    neighbors = graph["object"]["neighbors"]
    count = graph["object"]["position"].shape[1]
    if neighbors.numel() and not bool(((neighbors >= -1) & (neighbors < count)).all()):
        raise ValueError(
            f"object.neighbors must be in [-1, {count}), got values in [{int(neighbors.min())}, {int(neighbors.max())}]"
        )
    for node_type in NODE_TYPES:
        for key in ("position", "vectors", "scalars"):
            if not bool(torch.isfinite(graph[node_type][key]).all()):
                raise ValueError(f"{node_type}.{key} must be finite")
    if not bool(torch.isfinite(graph["gravity"]).all()):
        raise ValueError("gravity must be finite")


def _shape(nodes: Mapping[str, torch.Tensor], node_type: str, key: str) -> torch.Size:
    if key not in nodes:
        raise ValueError(f"graph[{node_type!r}] must have the key {key!r}, got {sorted(nodes)}")
    return nodes[key].shape


def _expect_shape(name: str, tensor: torch.Tensor, shape: tuple[int, ...], channels: tuple[Channel, ...] = ()) -> None:
    if tuple(tensor.shape) != shape:
        names = ", ".join(channel.name for channel in channels)
        raise ValueError(
            f"{name} must have shape {shape}, got {tuple(tensor.shape)}"
            + (f"; the schema has the channels {names}" if names else "")
        )


def _expect_dtype(name: str, tensor: torch.Tensor, dtype: str) -> None:
    fits = {
        "floating point": tensor.dtype.is_floating_point,
        "bool": tensor.dtype == torch.bool,
        "int64": tensor.dtype == torch.int64,
    }[dtype]
    if not fits:
        raise ValueError(f"{name} must be of dtype {dtype}, got {tensor.dtype}")
