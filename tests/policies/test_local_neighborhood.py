"""Edges of the homogeneous graph, and merging of node types."""

import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.policies.layers import LocalNeighborhood, MergedNodes

NODES, TOOLS, NEAREST = 12, 3, 4


def find(graph, num_nearest=NEAREST):
    nodes = MergedNodes(SCHEMA)(graph)
    return LocalNeighborhood.find(nodes["position"], nodes["mask"], graph["object"]["neighbors"], num_nearest)


def test_edges_are_those_of_a_search_by_hand():
    """Nearest nodes, the other actuators, the mesh, and the way back to the nearest actuator."""
    graph = make_graph(2, NODES, TOOLS, dtype=torch.float64)
    local = find(graph)
    for b in range(2):
        points, tools = graph["object"]["position"][b], graph["actuator"]["position"][b]
        squared = (tools[:, None] - points[None]).square().sum(-1)
        order = squared.argsort(dim=1)
        reach = squared.gather(1, order[:, NEAREST : NEAREST + 1])
        near = (1 - squared / reach).clamp(min=0).square()
        for a in range(TOOLS):
            row = local.actuators[b, a].tolist()
            assert set(row[:NEAREST]) == set(order[a, :NEAREST].tolist())
            assert row[NEAREST:] == [-1 if i == a else NODES + i for i in range(TOOLS)]
            expected = torch.cat([near[a, row[:NEAREST]], torch.ones(TOOLS).double()])
            torch.testing.assert_close(local.actuator_envelope[b, a], expected)
        for u in range(NODES):
            mesh, own = local.objects[b, u, :-1], int(local.objects[b, u, -1]) - NODES
            assert torch.equal(mesh, graph["object"]["neighbors"][b, u])
            first, second = squared[:, u].sort().values[:2]
            assert squared[own, u] == first
            expected = near[own, u] * (1 - first / second).square()
            torch.testing.assert_close(local.object_envelope[b, u, -1], expected)
            assert (local.object_envelope[b, u, :-1] == 1).all()


def test_edges_fade_out_before_they_end():
    """Moving a node across the reach of an actuator changes no weight abruptly."""
    graph = make_graph(1, NODES, 1, dtype=torch.float64)
    line = torch.arange(NODES).double()
    graph["object"]["position"] = torch.stack([line, 0 * line, 0 * line], dim=-1)[None]
    graph["actuator"]["position"].zero_()
    graph["object"]["neighbors"].fill_(-1)
    before = find(graph)
    assert before.actuators[0, 0, :NEAREST].tolist() == [0, 1, 2, 3]
    # Node 4, whose distance is the reach, changes places with node 3.
    graph["object"]["position"][0, 4, 0] = 3.0 - 1e-9
    graph["object"]["position"][0, 3, 0] = 3.0
    after = find(graph)
    assert set(after.actuators[0, 0, :NEAREST].tolist()) == {0, 1, 2, 4}
    assert after.actuator_envelope[0, 0, NEAREST - 1] < 1e-8


def test_everything_is_near_in_a_small_graph():
    """With no more than k nodes all are connected, at full weight, also where all coincide."""
    graph = make_graph(2, 3, TOOLS, dtype=torch.float64)
    local = find(graph)
    assert local.actuators.shape == (2, TOOLS, 3 + TOOLS)
    assert (local.actuator_envelope == 1).all()
    for node_type in ("object", "actuator"):
        graph[node_type]["position"].zero_()
    local = find(graph)
    assert torch.isfinite(local.object_envelope).all()
    assert torch.isfinite(local.actuator_envelope).all()


def test_masked_nodes_are_never_nearest():
    graph = make_graph(1, NODES, TOOLS, dtype=torch.float64)
    graph["object"]["position"][0, 5] = graph["actuator"]["position"][0, 1]
    graph["object"]["mask"][0, 5] = False
    graph["actuator"]["mask"][0, 2] = False
    local = find(graph)
    assert not (local.actuators[..., :NEAREST] == 5).any()
    assert not (local.objects[..., -1] == NODES + 2).any()


def test_merged_nodes_have_the_channels_of_both_types():
    """By name; zeros where a type lacks one; the type as one-hot at the end."""
    graph = make_graph(2, 5, 2)
    merge = MergedNodes(SCHEMA)
    nodes = merge(graph)
    assert (merge.num_vectors, merge.num_scalars) == (2, 7)
    assert nodes["vectors"].shape == (2, 7, 2, 3)
    assert nodes["mask"].shape == (2, 7)
    objects, tools = nodes["scalars"][:, :5], nodes["scalars"][:, 5:]
    # goal_distance, arc, held, contact | gripper_status | object, actuator
    assert torch.equal(objects[..., :4], graph["object"]["scalars"])
    assert torch.equal(tools[..., [0, 1, 4]], graph["actuator"]["scalars"])
    assert (objects[..., 4] == 0).all()
    assert (tools[..., 2:4] == 0).all()
    assert torch.equal(objects[..., 5:], torch.tensor([1.0, 0.0]).expand(2, 5, 2))
    assert torch.equal(tools[..., 5:], torch.tensor([0.0, 1.0]).expand(2, 2, 2))


def test_merging_matches_channels_by_name_not_by_place():
    def vectors(*names):
        return NodeSchema(tuple(Channel(name, "vector", "m", "test") for name in names), ())

    schema = GraphSchema(vectors("velocity", "goal"), vectors("goal", "force"), 1.0, 0.1)
    value = torch.arange(6.0).view(1, 1, 2, 3)
    node = {"position": torch.zeros(1, 1, 3), "scalars": torch.zeros(1, 1, 0)}
    node["mask"] = torch.ones(1, 1, dtype=torch.bool)
    graph = {"object": {**node, "vectors": value}, "actuator": {**node, "vectors": value + 10}}
    merged = MergedNodes(schema)(graph)["vectors"][0]
    zero = torch.zeros(3)
    assert torch.equal(merged[0], torch.stack([value[0, 0, 0], value[0, 0, 1], zero]))
    assert torch.equal(merged[1], torch.stack([zero, value[0, 0, 0] + 10, value[0, 0, 1] + 10]))
