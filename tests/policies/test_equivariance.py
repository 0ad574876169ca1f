"""SE(3) and permutation symmetry of whole policies, through their normaliser (eq. 4, 14, 34)."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from random_graphs import (
    ACTUATOR_COUNTS,
    NODE_COUNTS,
    QUATERNIONS,
    SCHEMA,
    SEEDS,
    TRANSLATIONS,
    make_graph,
    move,
    permute,
    relative_error,
    rotation_from_quaternion,
)

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.policies import make_policy
from maniskill_grpd.policies.layers import EdgeGeometry

TOLERANCE = {torch.float32: 1e-5, torch.float64: 1e-10}
NEGATIVE_CONTROL = 1e-2
VARIANTS = {
    "default": {},
    "deep": {"num_layers": 2, "num_local_radial": 3, "max_degree": 2},
    "no_object_rounds": {"num_layers": 0},
    "separate_value": {"value_encoder": "separate", "state_dependent_std": False},
}


def trained_looking_policy(dtype, seed, schema=SCHEMA, **options):
    """A policy whose every output depends on its input, with statistics in its normaliser."""
    torch.manual_seed(seed)
    policy = make_policy("grpd", schema, **options).to(dtype)
    for parameter in policy.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    return policy


@torch.no_grad()
def symmetry_errors(policy, graph, rotation, translation):
    """Relative errors of mean, standard deviation and value under a motion of the scene."""
    distribution, value = policy(graph)
    moved_distribution, moved_value = policy(move(graph, rotation, translation))
    return {
        "mean": relative_error(moved_distribution.mean, distribution.mean @ rotation.T),
        "std": relative_error(moved_distribution.std, distribution.std),
        "value": relative_error(moved_value, value),
    }


@pytest.mark.parametrize("dtype", TOLERANCE, ids=str)
@pytest.mark.parametrize("variant", VARIANTS)
@given(QUATERNIONS, TRANSLATIONS, NODE_COUNTS, ACTUATOR_COUNTS, SEEDS)
def test_moving_the_scene_moves_the_action(
    variant, dtype, quaternion, translation, nodes, actuators, seed
):
    """Mean rotates; standard deviation and value stay; gravity turns with the scene."""
    policy = trained_looking_policy(dtype, seed, **VARIANTS[variant])
    policy.normalizer.update(make_graph(seed=seed + 1, dtype=dtype))
    graph = make_graph(4, nodes, actuators, seed=seed, dtype=dtype)
    rotation = rotation_from_quaternion(quaternion, dtype)
    errors = symmetry_errors(policy, graph, rotation, torch.tensor(translation, dtype=dtype))
    assert max(errors.values()) < TOLERANCE[dtype], errors


@given(QUATERNIONS, SEEDS)
def test_relu_magnitude_is_equivariant(quaternion, seed):
    """In float64 only: next to the kink of relu, the relative error of a mean has no bound."""
    policy = trained_looking_policy(torch.float64, seed, magnitude="relu")
    rotation = rotation_from_quaternion(quaternion)
    graph = make_graph(seed=seed, dtype=torch.float64)
    errors = symmetry_errors(policy, graph, rotation, torch.zeros(3, dtype=torch.float64))
    assert max(errors.values()) < 1e-10, errors


@given(QUATERNIONS, SEEDS)
def test_statistics_do_not_depend_on_the_frame(quaternion, seed):
    """A normaliser fed with rotated data scales alike, so training commutes with rotation too."""
    graph = make_graph(seed=seed, dtype=torch.float64)
    moved = move(graph, rotation_from_quaternion(quaternion), torch.ones(3, dtype=torch.float64))
    policies = [trained_looking_policy(torch.float64, 0) for _ in range(2)]
    for policy, seen in zip(policies, (graph, moved), strict=True):
        policy.normalizer.update(seen)
    values = [policy.value(graph) for policy in policies]
    assert relative_error(*values) < 1e-10


@given(NODE_COUNTS, ACTUATOR_COUNTS, SEEDS, st.randoms(use_true_random=False))
def test_order_of_nodes_does_not_matter(nodes, actuators, seed, random):
    """Object order changes nothing; actuator order reorders the actions."""
    policy = trained_looking_policy(torch.float64, seed)
    graph = make_graph(3, nodes, actuators, seed=seed, dtype=torch.float64)
    node_order = torch.tensor(random.sample(range(nodes), nodes))
    actuator_order = torch.tensor(random.sample(range(actuators), actuators))
    with torch.no_grad():
        distribution, value = policy(graph)
        permuted, permuted_value = policy(permute(graph, node_order, actuator_order))
    assert relative_error(permuted.mean, distribution.mean[:, actuator_order]) < 1e-10
    assert relative_error(permuted.std, distribution.std[:, actuator_order]) < 1e-10
    assert relative_error(permuted_value, value) < 1e-10


def test_gravity_breaks_the_symmetry_unless_it_turns_too():
    """Turning everything but gravity must change the action, or up could not be told from down."""
    policy = trained_looking_policy(torch.float64, 0)
    graph = make_graph(dtype=torch.float64)
    rotation = rotation_from_quaternion((0.7, 0.7, 0.1, 0.0))
    moved = {**move(graph, rotation, torch.zeros(3)), "gravity": graph["gravity"]}
    with torch.no_grad():
        expected = policy.distribution(graph).mean @ rotation.T
        assert relative_error(policy.distribution(moved).mean, expected) > NEGATIVE_CONTROL


def test_negative_control_coordinates_as_scalars():
    """A policy that reads raw coordinates fails the same test."""
    coordinates = tuple(Channel(axis, "scalar", "m", "test") for axis in "xyz")
    schema = GraphSchema(
        NodeSchema(SCHEMA.object.vectors, SCHEMA.object.scalars + coordinates),
        SCHEMA.actuator,
        SCHEMA.length_scale,
        SCHEMA.edge_length,
    )
    policy = trained_looking_policy(torch.float64, 0, schema=schema)

    class Reader(torch.nn.Module):
        def forward(self, graph):
            nodes = graph["object"]
            scalars = torch.cat([nodes["scalars"], nodes["position"]], dim=-1)
            return policy({**graph, "object": {**nodes, "scalars": scalars}})

    assert_fails_symmetry(Reader())


def test_negative_control_printed_kernel(monkeypatch):
    """The kernel of eq. 20 and 31 as printed, a network of the direction, is not equivariant."""
    network = torch.nn.Sequential(
        torch.nn.Linear(3, 16), torch.nn.SiLU(), torch.nn.Linear(16, 3)
    ).double()
    factors = EdgeGeometry._factors

    def printed(self, offsets):
        radial, harmonics = factors(self, offsets)
        direction = torch.stack(harmonics[1:4], dim=-1)
        return radial, [harmonics[0], *network(direction).unbind(-1)]

    monkeypatch.setattr(EdgeGeometry, "_factors", printed)
    assert_fails_symmetry(trained_looking_policy(torch.float64, 0))


def test_negative_control_scale_per_axis():
    """Statistics per axis, the usual observation normalisation, break the symmetry."""
    policy = trained_looking_policy(torch.float64, 0)
    per_axis = torch.tensor([0.9, 0.7, 0.8], dtype=torch.float64)

    class PerAxis(torch.nn.Module):
        def forward(self, graph):
            nodes = {**graph["object"], "vectors": graph["object"]["vectors"] / per_axis}
            return policy({**graph, "object": nodes})

    assert_fails_symmetry(PerAxis())


def assert_fails_symmetry(policy):
    graph = make_graph(dtype=torch.float64)
    rotation = rotation_from_quaternion((0.5, 0.7, -0.4, 0.3))
    errors = symmetry_errors(policy, graph, rotation, torch.ones(3, dtype=torch.float64))
    assert errors["mean"] > NEGATIVE_CONTROL, errors
