"""Noise on observations: of the size asked for, on what it is to be on, telling nothing of the truth."""

import copy

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.evaluation import NoisyObserver
from maniskill_grpd.evaluation.observation_noise import add_noise
from maniskill_grpd.policies import make_policy

SIGMA = 0.05


def generator():
    return torch.Generator().manual_seed(0)


@pytest.fixture(scope="module")
def graph():
    graph = make_graph(batch=20, nodes=40, actuators=3)
    for nodes in (graph["object"], graph["actuator"]):
        nodes["scalars"][..., 0] = nodes["vectors"][..., 1, :].norm(dim=-1)  # goal_distance is that of goal_offset
    return graph


def test_positions_and_velocities_are_disturbed_by_sigma(graph):
    noisy = add_noise(graph, SCHEMA, SIGMA, generator())
    position = noisy["object"]["position"] - graph["object"]["position"]
    velocity = (noisy["object"]["vectors"] - graph["object"]["vectors"])[..., 0, :]
    # 20 * 40 * 3 = 2,400 samples: the standard deviation of the estimate is sigma / sqrt(4,800), 1.4 %
    assert position.std() == pytest.approx(SIGMA, rel=0.06)
    assert velocity.std() == pytest.approx(SIGMA, rel=0.06)
    assert abs(torch.corrcoef(torch.stack([position.flatten(), velocity.flatten()]))[0, 1]) < 0.1


def test_offsets_and_distances_are_seen_from_the_noisy_position(graph):
    noisy = add_noise(graph, SCHEMA, SIGMA, generator())
    for node_type in ("object", "actuator"):
        before, after = graph[node_type], noisy[node_type]
        goal = before["position"] + before["vectors"][..., 1, :]
        torch.testing.assert_close(after["position"] + after["vectors"][..., 1, :], goal)
        torch.testing.assert_close(after["scalars"][..., 0], after["vectors"][..., 1, :].norm(dim=-1))
        torch.testing.assert_close(after["scalars"][..., 1:], before["scalars"][..., 1:], rtol=0, atol=0)


def test_the_graph_itself_is_left_alone(graph):
    before = copy.deepcopy(graph)
    add_noise(graph, SCHEMA, SIGMA, generator())
    torch.testing.assert_close(graph, before, rtol=0, atol=0)


def test_without_noise_nothing_changes(graph):
    torch.testing.assert_close(add_noise(graph, SCHEMA, 0.0, generator()), graph)


def test_a_policy_sees_new_noise_at_every_step_and_the_same_in_every_repetition(graph):
    policy = make_policy("grpd", SCHEMA)
    first, second = (NoisyObserver(policy, SIGMA, generator()) for _ in range(2))
    actions = [first.act(graph, deterministic=True) for _ in range(2)]
    assert not torch.equal(*actions)
    torch.testing.assert_close(second.act(graph, deterministic=True), actions[0], rtol=0, atol=0)


def test_negative_sigma_is_refused():
    with pytest.raises(ValueError, match="must not be negative, got -1"):
        NoisyObserver(make_policy("grpd", SCHEMA), -1.0, generator())
