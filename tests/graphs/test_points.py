"""Graphs from point clouds."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from maniskill_grpd.graphs import Channel, point_schema, points_to_graph
from maniskill_grpd.policies import POLICIES, make_policy

SCHEMA = point_schema(length_scale=0.4, edge_length=0.08)
GOAL = Channel("goal_offset", "vector", "m", "test", starts_at="node")
HEIGHT = Channel("height", "scalar", "m", "test")


def clouds(batch=3, count=400, seed=0):
    """Return points (B, P, 3) on wavy sheets, of which some are not of the object."""
    rng = torch.Generator().manual_seed(seed)
    points = 0.4 * torch.rand(batch, count, 3, generator=rng) - 0.2
    points[..., 2] = 0.03 * torch.sin(15.0 * points[..., 0])
    return points, torch.rand(batch, count, generator=rng) < 0.7


def graph_of(points, mask, num_nodes=30, schema=SCHEMA, **options):
    batch = len(points)
    grippers = torch.tensor([[0.1, 0.0, 0.1], [-0.1, 0.0, 0.1]], dtype=points.dtype).repeat(batch, 1, 1)
    gravity = torch.tensor([0.0, 0.0, -9.81], dtype=points.dtype).repeat(batch, 1)
    closed = torch.tensor([True, False]).repeat(batch, 1)
    return points_to_graph(points, mask, grippers, closed, gravity, schema=schema, num_nodes=num_nodes, **options)


def test_nodes_cover_the_object_and_nothing_else():
    """Farthest points: no two nodes are closer to each other than any point of the object is to a node."""
    points, mask = clouds()
    points[~mask] = torch.nan
    graph = graph_of(points, mask)
    SCHEMA.validate(graph, values=True)
    for world in range(3):
        nodes, cloud = graph["object"]["position"][world].numpy(), points[world][mask[world]].numpy()
        distances, _ = cKDTree(cloud).query(nodes)
        assert distances.max() == 0.0
        covering = cKDTree(nodes).query(cloud)[0].max()
        spacing = cKDTree(nodes).query(nodes, k=2)[0][:, 1].min()
        assert covering <= spacing + 1e-7


def test_neighbors_are_the_nearest_nodes_within_reach():
    points, mask = clouds()
    graph = graph_of(points, mask, num_neighbors=5)
    position, neighbors = graph["object"]["position"].numpy(), graph["object"]["neighbors"].numpy()
    for world in range(3):
        distance, order = cKDTree(position[world]).query(position[world], k=6)
        expected = np.where(distance <= 3.0 * SCHEMA.edge_length, order, -1)[:, 1:]
        np.testing.assert_array_equal(neighbors[world], expected)
    far = graph_of(points, mask, schema=point_schema(length_scale=0.4, edge_length=0.001))
    assert (far["object"]["neighbors"] == -1).all()


def test_the_order_of_points_does_not_matter():
    points, mask = clouds()
    order = torch.randperm(points.shape[1], generator=torch.Generator().manual_seed(1))
    graph, permuted = graph_of(points, mask)["object"], graph_of(points[:, order], mask[:, order])["object"]
    assert all(torch.equal(graph[name], permuted[name]) for name in graph)


def test_a_cloud_that_is_turned_gives_the_graph_turned():
    points, mask = (clouds()[0].double(), clouds()[1])
    turn = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(2)))[0]
    graph, turned = graph_of(points, mask)["object"], graph_of(points @ turn.T + 1.0, mask)["object"]
    assert torch.equal(graph["neighbors"], turned["neighbors"])
    torch.testing.assert_close(graph["position"] @ turn.T + 1.0, turned["position"])
    stretched = graph_of(points * torch.tensor([1.0, 3.0, 1.0]), mask)["object"]
    assert not torch.equal(graph["neighbors"], stretched["neighbors"])


def test_what_is_known_of_points_goes_with_them():
    points, mask = clouds()
    schema = point_schema([HEIGHT, GOAL], length_scale=0.4, edge_length=0.08)
    graph = graph_of(points, mask, schema=schema, values={"goal_offset": 1.0 - points, "height": points[..., 2]})
    schema.validate(graph, values=True)
    nodes = graph["object"]
    assert torch.equal(nodes["vectors"][:, :, 0], 1.0 - nodes["position"])
    assert torch.equal(nodes["scalars"][..., 0], nodes["position"][..., 2])


def test_small_clouds_leave_nodes_masked():
    points, mask = clouds()
    mask[0, 4:], mask[1] = False, False
    mask[0, :4] = True
    graph = graph_of(points, mask)
    SCHEMA.validate(graph, values=True)
    assert graph["object"]["mask"].sum(dim=1).tolist() == [4, 0, 30]
    assert (graph["object"]["position"][1] == 0.0).all()
    neighbors = graph["object"]["neighbors"]
    assert (neighbors[1] == -1).all()
    assert (neighbors[0] < 4).all()


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_policies_take_graphs_of_points(name):
    graph = graph_of(*clouds())
    torch.manual_seed(0)
    policy = make_policy(name, SCHEMA)
    policy.normalizer.update(graph)
    distribution, value = policy(graph)
    assert torch.isfinite(distribution.mean).all()
    assert torch.isfinite(value).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": torch.zeros(3, 400)}, "points must be"),
        ({"mask": torch.ones(3, 400)}, "mask .* bool"),
        ({"num_nodes": 1}, "num_nodes must be >= 2"),
        ({"num_neighbors": 30}, r"num_neighbors must be in \[1, 30\)"),
        ({"values": {"height": torch.zeros(3, 400)}}, "values must be those of"),
        ({"points": torch.full((3, 400, 3), torch.nan)}, "must be finite"),
    ],
)
def test_bad_input_is_refused(change, message):
    points, mask = clouds()
    with pytest.raises(ValueError, match=message):
        graph_of(**{"points": points, "mask": mask, **change})
