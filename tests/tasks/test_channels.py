"""What channels say of themselves: every one of every task, against the observation of displaced worlds."""

import gc

import gymnasium as gym
import pytest
import torch
from mani_skill.utils.registration import REGISTERED_ENVS

from maniskill_grpd.graphs import Channel, GraphSchema, NodeSchema
from maniskill_grpd.graphs.displacement import displace
from maniskill_grpd.tasks import DeformableEnv

TASKS = [(uid, {}) for uid, spec in REGISTERED_ENVS.items() if issubclass(spec.cls, DeformableEnv)]
TASKS += [("ClothHanging-v1", {"hanger": "bar"}), ("RopeWrapping-v1", {"shapes": ("box", "prism")})]
SIZE = 1e-3
"""Standard deviation of the displacements per axis [m]."""
EXACT = {
    "RopeWrapping-v1": {"object": set(), "actuator": {"winding"}},
    "ClothHanging-v1": {
        "object": {"hanger_distance"},
        "actuator": {"seat_offset", "seat_normal", "seat_depth", "hanger_distance"},
    },
}
"""Channels that depend on positions in a way that only the simulation can tell: noise leaves them as they are."""


@pytest.fixture(params=TASKS, ids=lambda case: "-".join([case[0], *map(str, case[1].values())]))
def displaced(request, monkeypatch):
    """Return id, schema, the graph before and after nodes and grippers were displaced, and by how much."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    env_id, options = request.param
    env = gym.make(
        env_id, num_envs=8, sim_backend="cpu", render_backend="none", graph_nodes=None, graph_features="rich", **options
    )
    env.reset(seed=0)
    base = env.unwrapped
    generator = torch.Generator().manual_seed(1)
    for _ in range(3):
        env.step(0.6 * torch.randn(env.action_space.shape, generator=generator))
    before = base.get_obs()["graph"]
    shift = SIZE * torch.randn(base.solver.positions.shape, generator=generator)
    shift *= base.solver.node_mask[..., None]
    held = base.at_start_nodes(shift)  # a gripper is where the node is that it holds
    base.solver.positions += shift
    base.solver.gripper_positions += held
    yield env_id, options, base.graph_schema, before, base.get_obs()["graph"], {"object": shift, "actuator": held}
    env.close()


def test_channels_change_as_they_say(displaced):
    env_id, options, schema, before, after, shifts = displaced
    exact = EXACT.get(env_id, {})
    for node_type, shift in shifts.items():
        node = schema.node(node_type)
        told = displace(node, before[node_type], shift)
        left_alone = exact.get(node_type, set()) - ({"hanger_distance"} if "hanger" in options else set())
        for key, channels in (("vectors", node.vectors), ("scalars", node.scalars)):
            for place, channel in enumerate(channels):
                values = [graph[key][:, :, [place]] for graph in (told, after[node_type], before[node_type])]
                if channel.name in left_alone:
                    assert torch.equal(values[0], values[2]), channel.name
                    assert not torch.allclose(values[1], values[2], atol=SIZE / 100, rtol=0), channel.name
                elif channel.name != "contact":
                    wrong = (
                        ((values[0] - values[1]).abs() > (SIZE / 20 if "hanger" in options else SIZE / 100)).flatten(2).any(dim=2)
                    )
                    # A node that comes to lie beside the end of the bar was not told so; seen from beyond, the ends of the bar's
                    # surface and of its axis are 1 cm apart.
                    assert wrong.sum() <= ("hanger" in options), channel.name
        torch.testing.assert_close(told["position"], after[node_type]["position"])


def schema_of(*channels):
    kinds = [tuple(channel for channel in channels if channel.kind == kind) for kind in ("vector", "scalar")]
    return GraphSchema(NodeSchema(*kinds), NodeSchema(*kinds), 1.0, 1.0)


def test_channels_that_lie_are_noticed():
    """Negative control: a goal offset that says nothing of its start, or of what it crosses, does not follow the node."""
    position, axis = torch.zeros(1, 4, 3), torch.tensor([0.0, 0.0, 1.0]).expand(1, 4, 3)
    shift = torch.full((1, 4, 3), 0.01)
    nodes = {"position": position, "vectors": torch.stack([1.0 - axis, axis], dim=2), "scalars": torch.zeros(1, 4, 0)}
    changes = {}
    for name, says in (
        ("silent", {}),
        ("starts", {"starts_at": "node"}),
        ("across", {"starts_at": "node", "across": "axis"}),
        ("between", {"starts_at": "node", "ends_at": "partner"}),
    ):
        schema = schema_of(Channel("offset", "vector", "m", "", **says), Channel("axis", "vector", "", ""))
        changes[name] = displace(schema.object, nodes, shift)["vectors"][0, 0, 0] - nodes["vectors"][0, 0, 0]
    expected = {"silent": [0, 0, 0], "starts": [-0.01] * 3, "across": [-0.01, -0.01, 0.0], "between": [0, 0, 0]}
    for name, change in changes.items():
        torch.testing.assert_close(change, torch.tensor(expected[name], dtype=torch.float32), atol=1e-6, rtol=0)


@pytest.mark.parametrize(
    ("channels", "message"),
    [
        (lambda: Channel("a", "vector", "m", "", starts_at="gripper"), "starts_at of channel 'a' must be 'node'"),
        (lambda: Channel("a", "scalar", "m", "", starts_at="node"), "vectors take starts_at"),
        (lambda: Channel("a", "vector", "m", "", distance_of="b"), "scalars along and distance_of"),
        (lambda: schema_of(Channel("a", "scalar", "m", "", distance_of="b")), r"follows \['b'\]"),
    ],
)
def test_channels_that_say_nonsense_are_refused(channels, message):
    with pytest.raises(ValueError, match=message):
        channels()
