"""A policy behind noise."""

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.noisy_observer import NoisyObserver


@pytest.fixture(scope="module")
def policy():
    return make_policy("grpd", SCHEMA)


def observer(policy, sigma=0.05):
    return NoisyObserver(policy, sigma, torch.Generator().manual_seed(0))


def test_noise_is_new_at_every_step_and_the_same_in_every_repetition(policy):
    graph = make_graph()
    first, second = observer(policy), observer(policy)
    actions = [first.act(graph, deterministic=True) for _ in range(2)]
    assert not torch.equal(*actions)
    torch.testing.assert_close(second.act(graph, deterministic=True), actions[0], rtol=0, atol=0)


def test_more_noise_moves_the_action_further(policy):
    graph = make_graph(batch=50)
    exact = policy.act(graph, deterministic=True)
    errors = [(observer(policy, sigma).act(graph, deterministic=True) - exact).norm() for sigma in (0.0, 0.001, 0.1)]
    assert errors[0] == 0.0
    assert errors[0] < errors[1] < errors[2]


@pytest.mark.parametrize("sigma", [-1.0, float("nan")])
def test_bad_sigma_is_refused(policy, sigma):
    with pytest.raises(ValueError, match="sigma must not be negative"):
        observer(policy, sigma)


class Recorder:
    """Takes what a policy would see."""

    def __init__(self, schema):
        self.schema = schema

    def act(self, graph, deterministic=False, generator=None):
        """Keep the graph."""
        self.seen = graph


def test_velocities_are_as_noisy_as_positions():
    """Both with the deviation that was asked for, on the object and on the grippers, independent of each other."""
    nodes = NodeSchema(vectors=(Channel("velocity", "vector", "m/s", "test"),), scalars=())
    policy = Recorder(GraphSchema(object=nodes, actuator=nodes, length_scale=1.0, edge_length=1.0))
    part = {"position": torch.zeros(100, 10, 3), "vectors": torch.zeros(100, 10, 1, 3), "scalars": torch.zeros(100, 10, 0)}
    NoisyObserver(policy, 0.05, torch.Generator().manual_seed(0)).act({"object": part, "actuator": part})
    for name in ("object", "actuator"):
        moved, sped = policy.seen[name]["position"], policy.seen[name]["vectors"][..., 0, :]
        # 3,000 numbers: the deviation is known to 1.3 %, the correlation to 0.018.
        assert moved.std().item() == pytest.approx(0.05, rel=0.07)
        assert sped.std().item() == pytest.approx(0.05, rel=0.07)
        assert abs(torch.corrcoef(torch.stack([moved.flatten(), sped.flatten()]))[0, 1].item()) < 0.1
