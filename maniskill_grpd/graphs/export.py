"""Observation graphs in the formats of other libraries."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import torch

from maniskill_grpd.extras import import_extra
from maniskill_grpd.graphs.schema import NODE_TYPES, GraphSchema

if TYPE_CHECKING:
    import networkx
    from torch_geometric.data import HeteroData

MESH = ("object", "mesh", "object")
"""PyG edge type of the mesh edges (eq. 36)."""
BETWEEN = ("actuator", "with", "actuator")
"""PyG edge type between actuators, complete without self-loops (eq. 38)."""
GLOBAL = ("object", "to", "actuator")
"""PyG edge type from every object node to every actuator (eq. 40)."""


def to_hetero_data(graph: Mapping[str, Any], schema: GraphSchema) -> HeteroData:
    """Convert a batch of graphs to one PyG `HeteroData`, as PyG batches graphs.

    Masked nodes, and edges to them, are left out. With n and a unmasked nodes over the whole batch:

        data["object"], data["actuator"]
            pos (n, 3) [m], vectors (n, V, 3), scalars (n, S), x (n, 3 V + S): both in a row,
            batch (n,): graph of each node, ptr (B + 1,): where each graph begins
        data["object", "mesh", "object"], data["actuator", "with", "actuator"],
        data["object", "to", "actuator"]
            edge_index (2, E): senders, then receivers; edge_attr (E, 3): p_sender - p_receiver [m],
            eq. 25
        data.gravity (B, 3) [m/s^2]

    Args:
        graph: A raw or normalised graph.
        schema: What it holds.

    Raises:
        MissingExtraError: Without torch_geometric.
        ValueError: If the graph does not fit the schema.
    """
    hetero_data = import_extra("torch_geometric.data", "pyg", "exporting graphs")
    schema.validate(graph)
    data = hetero_data.HeteroData()
    for node_type in NODE_TYPES:
        _store_nodes(data[node_type], graph[node_type])
    objects, actuators = graph["object"]["mask"], graph["actuator"]["mask"]
    own = torch.eye(actuators.shape[1], dtype=torch.bool, device=actuators.device)
    edges = {
        MESH: _mesh_edges(graph["object"]["neighbors"], objects),
        BETWEEN: _complete_edges(actuators, actuators, ~own),
        GLOBAL: _complete_edges(objects, actuators, None),
    }
    for edge_type, edge_index in edges.items():
        sender, receiver = edge_index
        store = data[edge_type]
        store.edge_index = edge_index
        store.edge_attr = data[edge_type[0]].pos[sender] - data[edge_type[2]].pos[receiver]
    data.gravity = graph["gravity"]
    return data


def from_hetero_data(data: HeteroData, schema: GraphSchema) -> dict[str, Any]:
    """Convert a PyG `HeteroData` back to a batch of dense graphs.

    Inverse of `to_hetero_data` up to padding: nodes keep their order, padding stands at the end and
    holds zeros, and lists of neighbours are as long as the longest. Policies give the same actions.
    Also takes what `Batch.from_data_list` makes of single graphs. Edges other than those of the
    mesh are not read: they are complete.

    Args:
        data: Nodes with pos, vectors, scalars and batch; mesh edges; gravity.
        schema: What the graph holds.

    Raises:
        ValueError: If something is missing or does not fit the schema.
    """
    if "gravity" not in data:
        raise ValueError("data must have the attribute gravity (B, 3) [m/s^2]")
    gravity = data.gravity.reshape(-1, 3)
    graph: dict[str, Any] = {"gravity": gravity}
    for node_type in NODE_TYPES:
        graph[node_type] = _dense_nodes(data[node_type], node_type, len(gravity))
    nodes = data["object"]
    graph["object"]["neighbors"] = _dense_neighbors(
        data[MESH].edge_index, _batch_of(nodes, len(gravity)), graph["object"]["mask"]
    )
    schema.validate(graph)
    return graph


def to_networkx(graph: Mapping[str, Any], schema: GraphSchema, index: int = 0) -> networkx.DiGraph:
    """Convert one graph of a batch to a networkx graph, for drawing and graph algorithms.

    Nodes are ("object", i) and ("actuator", i) with the attributes `type`, `pos` and one per
    channel of the schema; edges go from sender to receiver and have the attribute `type`: "mesh",
    "with" or "to". Masked nodes are left out, and so are repetitions of an edge.

    Args:
        graph: A raw or normalised graph.
        schema: What it holds.
        index: Which graph of the batch.

    Raises:
        MissingExtraError: Without networkx.
        ValueError: If the graph does not fit the schema.
    """
    networkx = import_extra("networkx", "networkx", "exporting graphs")
    schema.validate(graph)
    result = networkx.DiGraph()
    present = {t: graph[t]["mask"][index].nonzero().flatten().tolist() for t in NODE_TYPES}
    for node_type in NODE_TYPES:
        nodes, channels = graph[node_type], schema.node(node_type)
        for i in present[node_type]:
            values = {c.name: nodes["vectors"][index, i, k] for k, c in enumerate(channels.vectors)}
            values |= {c.name: nodes["scalars"][index, i, k] for k, c in enumerate(channels.scalars)}
            attributes = {name: value.tolist() for name, value in values.items()}
            place = nodes["position"][index, i].tolist()
            result.add_node((node_type, i), type=node_type, pos=place, **attributes)
    neighbors = graph["object"]["neighbors"][index].tolist()
    mesh = [(s, r) for r in present["object"] for s in neighbors[r] if s in set(present["object"])]
    pairs = {
        MESH: mesh,
        BETWEEN: [(s, r) for s in present["actuator"] for r in present["actuator"] if s != r],
        GLOBAL: [(s, r) for s in present["object"] for r in present["actuator"]],
    }
    for (sender, relation, receiver), ends in pairs.items():
        result.add_edges_from((((sender, s), (receiver, r)) for s, r in ends), type=relation)
    return result


def _store_nodes(store: Any, nodes: Mapping[str, torch.Tensor]) -> None:
    """Fill a node store with the unmasked nodes."""
    mask = nodes["mask"]
    store.pos = nodes["position"][mask]
    store.vectors = nodes["vectors"][mask]
    store.scalars = nodes["scalars"][mask]
    store.x = torch.cat([store.vectors.flatten(1), store.scalars], dim=-1)
    store.batch = mask.nonzero()[:, 0]
    store.ptr = torch.nn.functional.pad(mask.sum(1).cumsum(0), (1, 0))


def _rows(mask: torch.Tensor) -> torch.Tensor:
    """Row of each node, (B, N), once masked nodes are left out; meaningless where masked."""
    return (mask.flatten().cumsum(0) - 1).view(mask.shape)


def _mesh_edges(neighbors: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Edges (2, E) of neighbour lists (B, N, K) between unmasked nodes (B, N), by receiver."""
    batch, count, columns = neighbors.shape
    listed = neighbors.clamp(min=0).flatten(1)
    exists = (neighbors >= 0) & mask[..., None]
    exists &= mask.gather(1, listed).view(neighbors.shape)
    rows = _rows(mask)
    senders = rows.gather(1, listed).view(neighbors.shape)
    receivers = rows[..., None].expand(batch, count, columns)
    return torch.stack([senders[exists], receivers[exists]])


def _complete_edges(senders: torch.Tensor, receivers: torch.Tensor, allowed: torch.Tensor | None) -> torch.Tensor:
    """Edges (2, E) between all unmasked nodes of a graph, by receiver; `allowed` is (R, S)."""
    exists = receivers[:, :, None] & senders[:, None]
    if allowed is not None:
        exists = exists & allowed
    sender_rows = _rows(senders)[:, None].expand(exists.shape)
    receiver_rows = _rows(receivers)[:, :, None].expand(exists.shape)
    return torch.stack([sender_rows[exists], receiver_rows[exists]])


def _batch_of(store: Any, num_graphs: int) -> torch.Tensor:
    """Graph of each node; a single graph may do without."""
    if "batch" in store:
        return store.batch
    if num_graphs != 1:
        raise ValueError(f"nodes of {num_graphs} graphs must have the attribute batch")
    return torch.zeros(len(store.pos), dtype=torch.int64, device=store.pos.device)


def _places(batch: torch.Tensor, num_graphs: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Place of each node within its graph, (n,), and number of nodes of each graph, (B,)."""
    sizes = torch.bincount(batch, minlength=num_graphs)
    first = sizes.cumsum(0) - sizes
    return torch.arange(len(batch), device=batch.device) - first[batch], sizes


def _dense_nodes(store: Any, node_type: str, num_graphs: int) -> dict[str, torch.Tensor]:
    missing = [key for key in ("pos", "vectors", "scalars") if key not in store]
    if missing:
        raise ValueError(f"data[{node_type!r}] must have pos, vectors and scalars, lacks {missing}")
    batch = _batch_of(store, num_graphs)
    if len(batch) and bool((batch.diff() < 0).any()):
        raise ValueError(f"data[{node_type!r}].batch must be sorted, as PyG keeps it")
    place, sizes = _places(batch, num_graphs)
    shape = (num_graphs, int(sizes.max()))
    dense = {"mask": torch.zeros(shape, dtype=torch.bool, device=batch.device)}
    dense["mask"][batch, place] = True
    for key, name in (("pos", "position"), ("vectors", "vectors"), ("scalars", "scalars")):
        values = store[key]
        dense[name] = values.new_zeros(*shape, *values.shape[1:])
        dense[name][batch, place] = values
    return dense


def _dense_neighbors(edge_index: torch.Tensor, batch: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Neighbour lists (B, N, K), -1 padded, from edges (2, E)."""
    place, _ = _places(batch, mask.shape[0])
    order = edge_index[1].argsort(stable=True)
    senders, receivers = edge_index[:, order]
    column, degrees = _places(receivers, len(batch))
    width = max(int(degrees.max()) if len(degrees) else 0, 1)
    neighbors = torch.full((*mask.shape, width), -1, dtype=torch.int64, device=mask.device)
    neighbors[batch[receivers], place[receivers], column] = place[senders]
    return neighbors
