"""Random observation graphs, and what a symmetry does to them."""

from __future__ import annotations

import torch
from hypothesis import strategies as st

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema


def _channels(kind, *names):
    return tuple(Channel(name, kind, "m", "test") for name in names)


SCHEMA = GraphSchema(
    object=NodeSchema(
        _channels("vector", "velocity", "goal_offset"), _channels("scalar", "goal_distance", "arc", "held", "contact")
    ),
    actuator=NodeSchema(
        _channels("vector", "velocity", "goal_offset"), _channels("scalar", "goal_distance", "arc", "gripper_status")
    ),
    length_scale=0.8,
    edge_length=0.05,
)


def make_graph(batch=4, nodes=12, actuators=3, neighbors=3, seed=0, dtype=torch.float32):
    """Random walks with random features and random, partly absent neighbours."""
    rng = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(*shape, generator=rng, dtype=dtype)

    def node(count, schema, position):
        scale = torch.tensor([0.3, 0.1], dtype=dtype)[:, None]
        return {
            "position": position,
            "vectors": normal(batch, count, schema.num_vectors, 3) * scale,
            "scalars": normal(batch, count, schema.num_scalars),
            "mask": torch.ones(batch, count, dtype=torch.bool),
        }

    points = (0.05 * normal(batch, nodes, 3)).cumsum(1)
    # Some grippers exactly at a node, as when they hold it.
    held = torch.arange(actuators) % nodes
    tools = points[:, held] + 0.1 * normal(batch, actuators, 3) * (torch.arange(actuators) % 2)[:, None]
    graph = {
        "object": node(nodes, SCHEMA.object, points),
        "actuator": node(actuators, SCHEMA.actuator, tools),
        "gravity": torch.tensor([0.0, 0.0, -9.81], dtype=dtype).repeat(batch, 1),
    }
    graph["object"]["neighbors"] = torch.randint(-1, nodes, (batch, nodes, neighbors), generator=rng)
    return graph


def move(graph, rotation, translation):
    """Rotate and translate a scene, and gravity with it."""
    moved = {"gravity": graph["gravity"] @ rotation.T}
    for node_type in ("object", "actuator"):
        moved[node_type] = {
            **graph[node_type],
            "position": graph[node_type]["position"] @ rotation.T + translation,
            "vectors": graph[node_type]["vectors"] @ rotation.T,
        }
    return moved


def permute(graph, node_order, actuator_order):
    """Put nodes and actuators in another order."""
    orders = {"object": node_order, "actuator": actuator_order}
    permuted = {"gravity": graph["gravity"]}
    for node_type, order in orders.items():
        permuted[node_type] = {key: value[:, order] for key, value in graph[node_type].items()}
    new_index = torch.argsort(node_order)
    neighbors = permuted["object"]["neighbors"]
    permuted["object"]["neighbors"] = torch.where(neighbors >= 0, new_index[neighbors], neighbors)
    return permuted


def rotation_from_quaternion(quaternion, dtype=torch.float64):
    """Rotation matrix of a quaternion (w, x, y, z) of any length but zero."""
    q = torch.tensor(quaternion, dtype=torch.float64)
    w, x, y, z = (q / q.norm()).tolist()
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return torch.tensor(rows, dtype=torch.float64).to(dtype)


def relative_error(actual, expected):
    """Length of the difference over the length of what was expected; 0 / 0 is 0."""
    difference = (actual - expected).detach().norm()
    return float(difference / expected.detach().norm().clamp(min=1e-30))


_COORDINATE = st.floats(-1.0, 1.0)
QUATERNIONS = st.tuples(*[_COORDINATE] * 4).filter(lambda q: sum(x * x for x in q) > 0.01)
TRANSLATIONS = st.tuples(*[_COORDINATE] * 3)
SEEDS = st.integers(0, 2**16)
NODE_COUNTS = st.integers(1, 24)
ACTUATOR_COUNTS = st.integers(1, 5)
