"""Noise on observed positions and velocities."""

import dataclasses

import pytest
import torch
from toy_env import SCHEMA, ToyEnv, ToyPolicy
from toy_run import CONFIG

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.learning import Trainer
from maniskill_grpd.learning.observation_noise import ObservationNoise
from maniskill_grpd.learning.rollout import graph_items

NODES = NodeSchema(
    vectors=(Channel("velocity", "vector", "m/s", ""), Channel("goal_offset", "vector", "m", "", starts_at="node")),
    scalars=(Channel("contact", "scalar", "", ""), Channel("goal_distance", "scalar", "m", "", distance_of="goal_offset")),
)
BOTH = GraphSchema(object=NODES, actuator=NODES, length_scale=1.0, edge_length=1.0)


def make_graph(batch=200, count=10):
    """Draw a graph whose goal offsets and distances follow from positions and goals."""
    graph, goals = {"gravity": torch.zeros(batch, 3)}, {}
    for name in ("object", "actuator"):
        position, goal = torch.randn(2, batch, count, 3)
        offset = goal - position
        graph[name] = {
            "position": position,
            "vectors": torch.stack([torch.randn(batch, count, 3), offset], dim=2),
            "scalars": torch.stack([torch.ones(batch, count), offset.norm(dim=-1)], dim=-1),
            "mask": torch.ones(batch, count, dtype=torch.bool),
        }
        goals[name] = goal
    return graph, goals


def disturb(graph, position_std=0.0, velocity_std=0.0, schema=BOTH):
    noise = ObservationNoise(schema=schema, position_std=position_std, velocity_std=velocity_std)
    return noise(graph, torch.Generator().manual_seed(0))


def test_noise_has_the_asked_size_and_leaves_the_rest_alone():
    graph, _ = make_graph()
    before = {name: tensor.clone() for name, tensor in graph_items(graph)}
    noisy = disturb(graph, 0.05, 0.3)
    for name in ("object", "actuator"):
        moved = noisy[name]["position"] - graph[name]["position"]
        sped = noisy[name]["vectors"][..., 0, :] - graph[name]["vectors"][..., 0, :]
        assert moved.std().item() == pytest.approx(0.05, rel=0.05)
        assert sped.std().item() == pytest.approx(0.3, rel=0.05)
        assert torch.equal(noisy[name]["scalars"][..., 0], graph[name]["scalars"][..., 0])
    for name, tensor in graph_items(graph):
        assert torch.equal(tensor, before[name]), name


def test_what_follows_from_a_position_follows_from_the_noisy_one():
    graph, goals = make_graph()
    noisy = disturb(graph, 0.05)
    for name, goal in goals.items():
        offset = goal - noisy[name]["position"]
        torch.testing.assert_close(noisy[name]["vectors"][..., 1, :], offset, atol=1e-5, rtol=0)
        distance = noisy[name]["scalars"][..., 1]
        torch.testing.assert_close(distance, offset.norm(dim=-1), atol=1e-5, rtol=0)


def test_a_distance_from_elsewhere_changes_little_under_little_noise():
    graph, _ = make_graph()
    graph["object"]["scalars"][..., 1] *= 0.5  # from a surface, half way
    noisy = disturb(graph, 1e-4)
    change = noisy["object"]["scalars"][..., 1] - graph["object"]["scalars"][..., 1]
    assert 0.0 < change.abs().max() < 1e-3


def test_without_noise_the_graph_is_handed_on():
    graph = ToyEnv(2).reset([0, 1])[0]["graph"]
    assert disturb(graph, schema=SCHEMA) is graph


def test_training_sees_the_noise(tmp_path):
    config = dataclasses.replace(CONFIG, position_noise=0.1, total_timesteps=8 * 7 * 2)
    trainer = Trainer(config, ToyPolicy(), ToyEnv(8), None, tmp_path)
    trainer.train()
    stored = trainer._collector.rollout.graph["object"]
    exact = stored["vectors"][..., 0, :] + stored["position"]  # the goal, noise cancels
    offset = exact - stored["position"]
    torch.testing.assert_close(stored["scalars"][..., 0], offset.norm(dim=-1))
    starts = stored["position"][1:] - stored["position"][:-1]
    assert starts.norm(dim=-1).max() > 0.15  # a step alone is at most 0.1 long
