"""Every actuator feels every object node after one round (eq. 11, 45-47, 69)."""

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.policies import make_policy


def jacobian_norms(policy, graph, key):
    """Norms of d mean_v / d input_u for all actuators v and object nodes u, (A, N)."""
    leaf = graph["object"][key].clone().requires_grad_()
    mean = policy.distribution({**graph, "object": {**graph["object"], key: leaf}}).mean[0]
    rows = []
    for actuator in range(mean.shape[0]):
        total = 0.0
        for axis in range(3):
            (gradient,) = torch.autograd.grad(mean[actuator, axis], leaf, retain_graph=True)
            total = total + gradient[0].flatten(1).square().sum(-1)
        rows.append(total.sqrt())
    return torch.stack(rows)


@pytest.mark.parametrize("key", ["vectors", "scalars", "position"])
@pytest.mark.parametrize("num_layers", [0, 1])
def test_every_actuator_depends_on_every_node(key, num_layers):
    """No pair has a vanishing Jacobian, though nodes have no mesh edges to pass messages along."""
    policy = make_policy("grpd", SCHEMA, num_layers=num_layers).double()
    graph = make_graph(1, 40, 4, dtype=torch.float64)
    graph["object"]["neighbors"].fill_(-1)
    norms = jacobian_norms(policy, graph, key)
    assert norms.shape == (4, 40)
    assert torch.isfinite(norms).all()
    assert norms.min() > 1e-9 * norms.max()
    assert norms.min() > 0.0


def test_distant_nodes_are_felt():
    """Ten object sizes away the constant radial function still carries the message."""
    policy = make_policy("grpd", SCHEMA).double()
    graph = make_graph(1, 5, 2, dtype=torch.float64)
    graph["object"]["position"][:, -1] += 10 * SCHEMA.length_scale
    norms = jacobian_norms(policy, graph, "vectors")
    assert norms[:, -1].min() > 1e-3 * norms.max()


def test_jacobian_is_finite_at_rest_on_the_goal():
    """All vectors zero, where lengths have no derivative of their own."""
    policy = make_policy("grpd", SCHEMA).double()
    graph = make_graph(1, 5, 2, dtype=torch.float64)
    for node_type in ("object", "actuator"):
        graph[node_type]["vectors"].zero_()
    assert torch.isfinite(jacobian_norms(policy, graph, "vectors")).all()
