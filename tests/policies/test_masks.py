"""Padding changes nothing."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from random_graphs import SCHEMA, SEEDS, make_graph

from maniskill_grpd.policies import POLICIES, make_policy

NAMES = sorted(POLICIES)


def pad(nodes, count, rng):
    """Append masked nodes full of NaN and put the true ones in random places."""
    batch, true_count = nodes["mask"].shape
    order = torch.randperm(true_count + count, generator=rng)
    padded = {}
    for key, value in nodes.items():
        if key == "neighbors":
            continue
        fill = torch.zeros if key == "mask" else lambda *a, **k: torch.full(*a, torch.nan, **k)
        extra = fill((batch, count, *value.shape[2:]), dtype=value.dtype)
        padded[key] = torch.cat([value, extra], dim=1)[:, order]
    place = torch.argsort(order)[:true_count]
    if "neighbors" in nodes:
        neighbors = nodes["neighbors"]
        moved = torch.where(neighbors >= 0, place[neighbors], neighbors)
        # Padding points anywhere, and true nodes have one more column without a neighbour.
        full = torch.randint(-1, true_count + count, (batch, true_count + count, neighbors.shape[2] + 1), generator=rng)
        full[:, place] = torch.cat([moved, -torch.ones_like(moved[..., :1])], dim=-1)
        padded["neighbors"] = full
    return padded, place


@pytest.mark.parametrize("name", NAMES)
@given(SEEDS, st.integers(0, 4), st.integers(0, 3), st.sampled_from([3, 8, 12]))
def test_padding_nodes_and_actuators_changes_nothing(name, seed, extra_nodes, extra_actuators, nodes):
    """Distribution of the true actuators and value stay, whatever stands in the padding."""
    torch.manual_seed(seed)
    policy = make_policy(name, SCHEMA, gripper=True).double()
    graph = make_graph(nodes=nodes, seed=seed, dtype=torch.float64)
    policy.normalizer.update(graph)
    rng = torch.Generator().manual_seed(seed)
    objects, _ = pad(graph["object"], extra_nodes, rng)
    grippers, place = pad(graph["actuator"], extra_actuators, rng)
    padded = {"object": objects, "actuator": grippers, "gravity": graph["gravity"]}
    distribution, value = policy(graph)
    padded_distribution, padded_value = policy(padded)
    torch.testing.assert_close(padded_value, value)
    torch.testing.assert_close(padded_distribution.mean[:, place], distribution.mean)
    torch.testing.assert_close(padded_distribution.std[:, place], distribution.std)
    action = torch.rand(4, 3 + extra_actuators, 4, dtype=torch.float64).round()
    torch.testing.assert_close(padded_distribution.log_prob(action), distribution.log_prob(action[:, place]))
    torch.testing.assert_close(padded_distribution.entropy(), distribution.entropy())


@pytest.mark.parametrize("name", NAMES)
def test_gradients_stay_finite_with_padding(name):
    """NaN in the padding must not reach the weights through a product with zero."""
    policy = make_policy(name, SCHEMA)
    graph = make_graph()
    rng = torch.Generator().manual_seed(0)
    nodes, _ = pad(graph["object"], 3, rng)
    grippers, _ = pad(graph["actuator"], 2, rng)
    padded = {"object": nodes, "actuator": grippers, "gravity": graph["gravity"]}
    policy.normalizer.update(padded)
    distribution, value = policy(padded)
    (distribution.log_prob(torch.zeros(4, 15)).sum() + value.sum()).backward()
    assert all(torch.isfinite(parameter.grad).all() for parameter in policy.parameters())


@pytest.mark.parametrize("name", NAMES)
def test_masked_neighbor_is_no_neighbor(name):
    """A neighbour list that points at a masked node reads as one that points nowhere."""
    policy = make_policy(name, SCHEMA).double()
    graph = make_graph(dtype=torch.float64)
    graph["object"]["mask"][:, 0] = False
    pruned = {**graph, "object": dict(graph["object"])}
    neighbors = graph["object"]["neighbors"]
    pruned["object"]["neighbors"] = torch.where(neighbors == 0, -1, neighbors)
    torch.testing.assert_close(policy.value(pruned), policy.value(graph))


@pytest.mark.parametrize("name", NAMES)
def test_graphs_of_a_batch_do_not_mix(name):
    """Each graph gets what it would get alone."""
    policy = make_policy(name, SCHEMA).double()
    graph = make_graph(batch=3, dtype=torch.float64)
    whole = policy.distribution(graph).mean
    for i in range(3):
        alone = {
            key: value[i : i + 1] if key == "gravity" else {k: v[i : i + 1] for k, v in value.items()}
            for key, value in graph.items()
        }
        torch.testing.assert_close(policy.distribution(alone).mean, whole[i : i + 1])
