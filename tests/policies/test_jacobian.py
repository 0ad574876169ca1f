"""Which object nodes each actuator feels (eq. 11, 45-47, 69)."""

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


def rope_graph(nodes, held, neighbors=True):
    """A rope along a wavy line, grippers at the given nodes, each node a neighbour of the next."""
    graph = make_graph(1, nodes, len(held), neighbors=2, dtype=torch.float64)
    t = torch.arange(nodes).double()
    graph["object"]["position"] = torch.stack([0.02 * t, 0.01 * t.sin(), 0.0 * t], dim=-1)[None]
    graph["actuator"]["position"] = graph["object"]["position"][:, held]
    index = torch.arange(nodes)
    chain = torch.stack([index - 1, torch.where(index + 1 < nodes, index + 1, -1)], dim=-1)
    graph["object"]["neighbors"] = (chain if neighbors else torch.full_like(chain, -1))[None]
    return graph


@pytest.mark.parametrize("num_layers", [1, 2, 3])
def test_local_messages_end_after_as_many_edges_as_rounds(num_layers):
    """Eq. 46: in `empn` a far node has no influence at all, in `grpd` every node has.

    An actuator at node 10 of 60 with 4 nearest nodes is joined with nodes 8 to 12; its fifth
    nearest only sets the reach. Each further round lets it see one node more on either side.
    """
    graph = rope_graph(60, [10])
    empn = make_policy("empn", SCHEMA, num_layers=num_layers, num_nearest=5).double()
    norms = jacobian_norms(empn, graph, "vectors")[0]
    reach = 2 + num_layers - 1
    seen = (torch.arange(60) - 10).abs() <= reach
    assert (norms[~seen] == 0.0).all()
    assert (norms[seen] > 0.0).all()
    grpd = make_policy("grpd", SCHEMA, num_layers=num_layers).double()
    norms = jacobian_norms(grpd, graph, "vectors")[0]
    assert norms.min() > 1e-6 * norms.max()


def test_sensitivity_decays_with_distance_in_local_messages_only():
    """Over-squashing: what a chain of rounds passes on falls by an order and more; `grpd` is flat.

    Ratio of the influence of the farthest node that five rounds reach to that of the nearest.
    """
    graph = rope_graph(40, [0])
    torch.manual_seed(0)
    ratios = {}
    for name, options in (("empn", {"num_layers": 5, "num_nearest": 1}), ("grpd", {})):
        norms = sum(jacobian_norms(make_policy(name, SCHEMA, **options).double(), graph, "vectors")[0] for _ in range(5))
        ratios[name] = float(norms[4] / norms[0])
    assert ratios["empn"] < 0.1
    assert ratios["grpd"] > 0.3


@pytest.mark.parametrize("name", ["hetero_gnn", "transformer"])
def test_baselines_with_global_messages_feel_every_node(name):
    """They lose to symmetry, not to reach."""
    graph = rope_graph(40, [0, 10, 39], neighbors=False)
    norms = jacobian_norms(make_policy(name, SCHEMA).double(), graph, "vectors")
    assert norms.min() > 1e-6 * norms.max()


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


def test_grippers_exchange_messages_before_they_hear_of_the_object():
    """Eq. 38 and 39 come before eq. 40 and 41: after the former, grippers know nothing of the object."""
    policy = make_policy("grpd", SCHEMA).double()
    graph = make_graph(1, 12, 3, dtype=torch.float64)
    leaf = graph["object"]["vectors"].requires_grad_()
    after = {}
    for name in ("actuator_round", "global_round"):
        module = getattr(policy.encoder, name)
        module.register_forward_hook(lambda module, inputs, output, name=name: after.update({name: output}))
    policy.distribution(graph)
    felt = {
        name: torch.autograd.grad(sum(t.sum() for t in features), leaf, retain_graph=True, allow_unused=True)[0]
        if any(t.requires_grad for t in features)
        else None
        for name, features in after.items()
    }
    assert felt["actuator_round"] is None or felt["actuator_round"].abs().max() == 0.0
    assert felt["global_round"][graph["object"]["mask"]].abs().min() > 0.0
