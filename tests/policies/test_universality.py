"""Policies can represent what they should learn; a magnitude held at zero by relu cannot."""

import math

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.policies import POLICIES, make_policy

STEPS = 200


def expert_like_actions(graph):
    """Actions that need all message paths: the way to the goal, bent by the object and the others.

    Each actuator goes to its goal, is drawn to the centre of the object, keeps away from the other
    actuators and pulls along the direction in which the object extends from it.
    """
    tools, points = graph["actuator"]["position"], graph["object"]["position"]
    away = (tools - tools.mean(1, keepdim=True)).nan_to_num()
    to_center = points.mean(1, keepdim=True) - tools
    pull = graph["object"]["vectors"][:, :, 1].mean(1, keepdim=True)
    wanted = 5.0 * graph["actuator"]["vectors"][:, :, 1] + to_center + away + 5.0 * pull
    return wanted / wanted.norm(dim=-1, keepdim=True).clamp(min=1.0)


def overfit(policy, graph, target, steps=STEPS):
    """Train on a few graphs; relative error of the mean actions in the end."""
    policy.normalizer.update(graph)
    optimizer = torch.optim.Adam(policy.parameters(), 5e-3)
    for step in range(steps):
        for group in optimizer.param_groups:
            group["lr"] = 5e-3 * 0.5 * (1.0 + math.cos(math.pi * step / steps)) + 1e-6
        optimizer.zero_grad()
        (policy.distribution(graph).mean - target).square().sum(-1).mean().backward()
        optimizer.step()
    with torch.no_grad():
        return float((policy.distribution(graph).mean - target).norm() / target.norm())


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_policies_can_overfit_a_few_expert_actions(name):
    """Below 1 % of the length of the actions, for every policy."""
    graph = make_graph(8, 8, 2, seed=3)
    assert overfit(make_policy(name, SCHEMA), graph, expert_like_actions(graph)) < 0.01


@pytest.mark.parametrize("magnitude", ["sigmoid", "softplus", "relu"])
def test_dead_magnitudes_revive_unless_relu_holds_them(magnitude):
    """All start at a bias of -5. Sigmoid and softplus recover; relu (eq. 52 as printed) has no gradient."""
    policy = make_policy("grpd", SCHEMA, magnitude=magnitude)
    torch.nn.init.constant_(policy.mean.length.bias, -5.0)
    graph = make_graph(8, 8, 2, seed=3)
    target = expert_like_actions(graph)
    before = {name: value.clone() for name, value in policy.named_parameters()}
    error = overfit(policy, graph, target)
    if magnitude != "relu":
        assert error < 0.01
    else:
        assert error == 1.0
        assert all(torch.equal(value, before[name]) for name, value in policy.named_parameters())


def test_naive_decoder_can_overfit_too():
    """The ablation (eq. 50) is not limited in what it can represent."""
    graph = make_graph(8, 8, 2, seed=3)
    policy = make_policy("grpd", SCHEMA, decoder="naive")
    assert overfit(policy, graph, expert_like_actions(graph)) < 0.01
