"""What policies compute before any weight is used may be kept and picked from."""

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.learning.rollout import cat_graphs, graph_items, map_graph
from maniskill_grpd.policies import POLICIES, make_policy

SMALL, LARGE = 12, 48  # nodes, of 3 neighbours: edges as a matrix, and as lists


@pytest.mark.parametrize("nodes", [SMALL, LARGE])
@pytest.mark.parametrize("name", sorted(POLICIES))
def test_picking_prepared_graphs_is_preparing_picked_ones(name, nodes):
    """Joined parts, picked out of order, give the distributions and values of the raw graphs there."""
    policy = make_policy(name, SCHEMA)
    graph = make_graph(batch=6, nodes=nodes)
    policy.normalizer.update(graph)
    parts = [policy.prepare(map_graph(lambda tensor, span=span: tensor[span], graph)) for span in (slice(0, 4), slice(4, 6))]
    pick = torch.tensor([5, 0, 3])
    picked = map_graph(lambda tensor: tensor[pick], cat_graphs(parts))
    dist, value = policy.evaluate(picked, actor=True, critic=True)
    expected, expected_value = policy(map_graph(lambda tensor: tensor[pick], graph))
    assert torch.equal(dist.mean, expected.mean)
    assert torch.equal(dist.std, expected.std)
    assert torch.equal(value, expected_value)


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_preparation_knows_no_weights(name):
    """Policies with other weights and equal scales prepare the same."""
    graph = make_graph()
    prepared = []
    for seed in range(2):
        torch.manual_seed(seed)
        policy = make_policy(name, SCHEMA)
        policy.normalizer.update(graph)
        prepared.append(dict(graph_items(policy.prepare(graph))))
    assert prepared[0].keys() == prepared[1].keys()
    assert all(torch.equal(tensor, prepared[1][key]) for key, tensor in prepared[0].items() if tensor is not None)
