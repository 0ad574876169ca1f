"""The graph schema: what it accepts, refuses and says."""

import json

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema


def test_valid_graph_passes():
    SCHEMA.validate(make_graph())
    SCHEMA.validate(make_graph(), values=True)


def broken(node_type, key, change):
    graph = make_graph()
    graph[node_type][key] = change(graph[node_type][key])
    return graph


@pytest.mark.parametrize(
    ("node_type", "key", "change", "message"),
    [
        ("object", "position", lambda x: x[..., :2], r"object.position .*\(4, 12, 3\).*\(4, 12, 2\)"),
        ("object", "vectors", lambda x: x[:, :, :1], r"object.vectors .*\(4, 12, 2, 3\).*\(4, 12, 1, 3\)"),
        ("object", "scalars", lambda x: x[:, :5], r"object.scalars .*\(4, 12, 4\).*\(4, 5, 4\)"),
        ("object", "mask", lambda x: x.float(), r"object.mask .*bool.*float32"),
        ("object", "neighbors", lambda x: x.int(), r"object.neighbors .*int64.*int32"),
        ("object", "neighbors", lambda x: x[:, :5], r"object.neighbors .*\(4, 12, 3\).*\(4, 5, 3\)"),
        ("object", "neighbors", lambda x: x[..., :0], "at least one column"),
        ("actuator", "position", lambda x: x[:2], r"actuator.position .*\(4, 3, 3\).*\(2, 3, 3\)"),
        ("actuator", "scalars", lambda x: x.long(), r"actuator.scalars .*floating point.*int64"),
    ],
)
def test_mismatch_names_expected_and_given(node_type, key, change, message):
    with pytest.raises(ValueError, match=message):
        SCHEMA.validate(broken(node_type, key, change))


@pytest.mark.parametrize("key", ["position", "vectors", "scalars", "mask", "neighbors"])
def test_missing_tensor_is_named(key):
    graph = make_graph()
    del graph["object"][key]
    with pytest.raises(ValueError, match=key):
        SCHEMA.validate(graph)


@pytest.mark.parametrize("key", ["object", "actuator", "gravity"])
def test_missing_part_is_named(key):
    graph = make_graph()
    del graph[key]
    with pytest.raises(ValueError, match=key):
        SCHEMA.validate(graph)


def test_gravity_of_another_batch_is_refused():
    graph = make_graph()
    graph["gravity"] = graph["gravity"][:1]
    with pytest.raises(ValueError, match=r"gravity .*\(4, 3\).*\(1, 3\)"):
        SCHEMA.validate(graph)


def test_values_are_checked_on_request():
    graph = make_graph()
    graph["object"]["neighbors"][0, 0, 0] = 12
    SCHEMA.validate(graph)
    with pytest.raises(ValueError, match=r"neighbors must be in \[-1, 12\)"):
        SCHEMA.validate(graph, values=True)
    graph = broken("actuator", "vectors", lambda x: x * torch.nan)
    with pytest.raises(ValueError, match="actuator.vectors must be finite"):
        SCHEMA.validate(graph, values=True)


def test_dictionary_round_trip_through_json():
    assert GraphSchema.from_dict(json.loads(json.dumps(SCHEMA.to_dict()))) == SCHEMA


def test_description_names_every_channel():
    text = SCHEMA.describe()
    for node in (SCHEMA.object, SCHEMA.actuator):
        for channel in (*node.vectors, *node.scalars):
            assert channel.name in text
    assert "gravity" in text


def test_nonsense_is_refused_at_construction():
    vector, scalar = Channel("a", "vector", "m", ""), Channel("b", "scalar", "", "")
    with pytest.raises(ValueError, match="tensor"):
        Channel("c", "tensor", "", "")
    with pytest.raises(ValueError, match="another kind"):
        NodeSchema((scalar,), ())
    with pytest.raises(ValueError, match="unique"):
        NodeSchema((vector, vector), ())
    node = NodeSchema((vector,), (scalar,))
    with pytest.raises(ValueError, match="length_scale must be positive"):
        GraphSchema(node, node, 0.0, 1.0)
