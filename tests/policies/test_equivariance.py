"""SE(3) and permutation symmetry of whole policies, through their normaliser (eq. 4, 14, 34)."""

from types import SimpleNamespace

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
from maniskill_grpd.policies import POLICIES, make_policy
from maniskill_grpd.policies.layers import EdgeGeometry

TOLERANCE = {torch.float32: 1e-5, torch.float64: 1e-10}
NEGATIVE_CONTROL = 1e-2
EQUIVARIANT = ("grpd", "empn")
VARIANTS = {
    "default": ("grpd", {}),
    "deep": ("grpd", {"num_layers": 2, "num_local_radial": 3, "max_degree": 2}),
    "no_object_rounds": ("grpd", {"num_layers": 0}),
    "no_gates": ("grpd", {"receiver_gates": False}),
    "separate_value": ("grpd", {"value_encoder": "separate", "state_dependent_std": False}),
    "naive": ("grpd", {"decoder": "naive"}),
    "directed": ("grpd", {"noise": "directed"}),
    "independent": ("grpd", {"decoders": "independent", "num_decoders": 5, "gripper": True}),
    "local_degree_2": ("grpd", {"max_local_degree": 2, "normalize_vectors": True}),
    "shared": ("grpd", {"weights": "shared", "num_layers": 2}),
    "no_object_messages": ("grpd", {"object_messages": False}),
    "empn": ("empn", {"gripper": True}),
    "empn_naive": ("empn", {"decoder": "naive", "num_nearest": 2, "max_degree": 2, "num_layers": 2}),
}


def trained_looking_policy(dtype, seed, schema=SCHEMA, name="grpd", **options):
    """A policy whose every output depends on its input, with statistics in its normaliser."""
    torch.manual_seed(seed)
    policy = make_policy(name, schema, **options).to(dtype)
    for parameter in policy.parameters():
        parameter.data += 0.1 * torch.randn_like(parameter)
    return policy


@torch.no_grad()
def symmetry_errors(policy, graph, rotation, translation):
    """Relative errors of all outputs under a motion of the scene.

    `limited` is the mean action behind the controller's limit, a ball: |a| <= 1 per actuator.
    """
    distribution, value = policy(graph)
    moved_distribution, moved_value = policy(move(graph, rotation, translation))
    mean, moved_mean = distribution.mean, moved_distribution.mean
    errors = {
        "mean": relative_error(moved_mean, mean @ rotation.T),
        "limited": relative_error(limit(5.0 * moved_mean), limit(5.0 * mean) @ rotation.T),
        "std": relative_error(moved_distribution.std, distribution.std),
        "value": relative_error(moved_value, value),
    }
    if distribution.gripper_logits is not None:
        errors["gripper"] = relative_error(moved_distribution.gripper_logits.sigmoid(), distribution.gripper_logits.sigmoid())
    return errors


def limit(action):
    """What the controller makes of actions (..., 3): the direction kept, the norm at most one."""
    return action / action.norm(dim=-1, keepdim=True).clamp(min=1.0)


@pytest.mark.parametrize("dtype", TOLERANCE, ids=str)
@pytest.mark.parametrize("variant", VARIANTS)
@given(QUATERNIONS, TRANSLATIONS, NODE_COUNTS, ACTUATOR_COUNTS, SEEDS)
def test_moving_the_scene_moves_the_action(variant, dtype, quaternion, translation, nodes, actuators, seed):
    """Mean rotates; standard deviation and value stay; gravity turns with the scene."""
    name, options = VARIANTS[variant]
    policy = trained_looking_policy(dtype, seed, name=name, **options)
    policy.normalizer.update(make_graph(seed=seed + 1, dtype=dtype))
    graph = make_graph(4, nodes, actuators, seed=seed, dtype=dtype)
    rotation = rotation_from_quaternion(quaternion, dtype)
    errors = symmetry_errors(policy, graph, rotation, torch.tensor(translation, dtype=dtype))
    assert max(errors.values()) < TOLERANCE[dtype], errors


@pytest.mark.parametrize("dtype", TOLERANCE, ids=str)
@pytest.mark.parametrize("name", sorted(set(POLICIES) - {"hepi"}))
def test_only_equivariant_policies_are_equivariant(name, dtype):
    """One test for four policies: `grpd` and `empn` pass it, the other two must fail it.

    Over 30 random scenes, sizes and motions. Of those that are not equivariant the *smallest* error
    counts, and of their outputs the mean action, the standard deviation and the value each.
    """
    rng = torch.Generator().manual_seed(0)
    worst, least = {}, {}
    for seed in range(30):
        policy = trained_looking_policy(dtype, seed, name=name)
        policy.normalizer.update(make_graph(seed=seed + 1, dtype=dtype))
        graph = make_graph(4, 1 + seed, 1 + seed % 5, seed=seed, dtype=dtype)
        rotation = rotation_from_quaternion(torch.randn(4, generator=rng).tolist(), dtype)
        translation = torch.randn(3, generator=rng).to(dtype)
        for key, error in symmetry_errors(policy, graph, rotation, translation).items():
            worst[key] = max(worst.get(key, 0.0), error)
            least[key] = min(least.get(key, torch.inf), error)
    if name in EQUIVARIANT:
        assert max(worst.values()) < TOLERANCE[dtype], worst
    else:
        assert min(least.values()) > NEGATIVE_CONTROL, least


@pytest.mark.parametrize("name", EQUIVARIANT)
def test_straight_rope_held_at_its_nodes_is_no_exception(name):
    """All distances are tied there, which is where edges chosen by distance break symmetry."""
    for nodes, actuators in ((41, 4), (20, 3), (7, 2)):
        policy = trained_looking_policy(torch.float64, nodes, name=name)
        graph = make_graph(2, nodes, actuators, dtype=torch.float64)
        line = torch.linspace(0.0, 0.8, nodes, dtype=torch.float64)
        graph["object"]["position"] = line[None, :, None] * torch.tensor([1.0, 0.0, 0.0])
        graph["object"]["position"] = graph["object"]["position"].repeat(2, 1, 1)
        held = torch.linspace(0, nodes - 1, actuators).long()
        graph["actuator"]["position"] = graph["object"]["position"][:, held]
        for quaternion in ((0.3, -0.5, 0.2, 0.7), (0.9, 0.1, 0.4, -0.2), (0.1, 0.2, 0.3, 0.4)):
            errors = symmetry_errors(policy, graph, rotation_from_quaternion(quaternion), torch.ones(3).double())
            assert max(errors.values()) < TOLERANCE[torch.float64], errors


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


@pytest.mark.parametrize("name", sorted(POLICIES))
@given(NODE_COUNTS, ACTUATOR_COUNTS, SEEDS, st.randoms(use_true_random=False))
def test_order_of_nodes_does_not_matter(name, nodes, actuators, seed, random):
    """Object order changes nothing; actuator order reorders the actions. For all policies."""
    policy = trained_looking_policy(torch.float64, seed, name=name)
    graph = make_graph(3, nodes, actuators, seed=seed, dtype=torch.float64)
    node_order = torch.tensor(random.sample(range(nodes), nodes))
    actuator_order = torch.tensor(random.sample(range(actuators), actuators))
    with torch.no_grad():
        distribution, value = policy(graph)
        permuted, permuted_value = policy(permute(graph, node_order, actuator_order))
    assert relative_error(permuted.mean, distribution.mean[:, actuator_order]) < 1e-10
    assert relative_error(permuted.std, distribution.std[:, actuator_order]) < 1e-10
    assert relative_error(permuted_value, value) < 1e-10


@pytest.mark.parametrize("decoders", ["shared", "independent"])
def test_independent_decoders_tell_actuators_apart(decoders):
    """What independent decoders give up: swapping two actuators does not swap their actions."""
    policy = trained_looking_policy(torch.float64, 0, decoders=decoders)
    graph = make_graph(dtype=torch.float64)
    order = torch.tensor([1, 0, 2])
    with torch.no_grad():
        expected = policy.distribution(graph).mean[:, order]
        actual = policy.distribution(permute(graph, torch.arange(12), order)).mean
    error = relative_error(actual, expected)
    assert error < 1e-10 if decoders == "shared" else error > NEGATIVE_CONTROL


def test_the_controller_limits_by_norm():
    """The displacement limit of the simulated grippers commutes with rotations; a box does not."""
    controller = pytest.importorskip("maniskill_grpd.agents.delta_position_controller")
    step = SimpleNamespace(config=SimpleNamespace(step_size=0.03))

    def displacement(action):
        return controller.DeltaPositionController._displacements(step, action)

    policy = trained_looking_policy(torch.float32, 0)
    graph = make_graph()
    rotation = rotation_from_quaternion((0.5, 0.7, -0.4, 0.3), torch.float32)
    with torch.no_grad():
        before = 20.0 * policy.distribution(graph).mean
        after = 20.0 * policy.distribution(move(graph, rotation, torch.ones(3))).mean
    assert before.norm(dim=-1).max() > 1.0
    torch.testing.assert_close(displacement(before), 0.03 * limit(before))
    assert relative_error(displacement(after), displacement(before) @ rotation.T) < 1e-5
    box = relative_error(after.clamp(-1, 1), before.clamp(-1, 1) @ rotation.T)
    assert box > NEGATIVE_CONTROL


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
    network = torch.nn.Sequential(torch.nn.Linear(3, 16), torch.nn.SiLU(), torch.nn.Linear(16, 3)).double()
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
