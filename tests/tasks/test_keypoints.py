"""Graphs of keypoints, what critics see beside them, and noise that follows from the seeds of the worlds."""

import gymnasium as gym
import numpy as np
import pytest
import torch

from maniskill_grpd.policies import POLICIES, make_policy
from maniskill_grpd.tasks.observation.keypoint_view import bend_angles, choose_keypoints, is_corner, relative_neighbors

ENV_ID = "ClothFolding-v1"
CAMERA = {"visibility": "camera", "sensor_configs": {"base_camera": {"width": 64, "height": 64}}}
ROTATION = torch.tensor([[-0.5, -(0.75**0.5), 0.0], [0.75**0.5, -0.5, 0.0], [0.0, 0.0, 1.0]])


def keypoints(env):
    return env.unwrapped.get_obs()["graph"]["object"]


def bend(env):
    """Lay the cloth of every world in waves that differ from world to world, so that no two nodes are bent alike."""
    points = env.unwrapped.solver.positions
    phase = torch.arange(len(points))[:, None] + 0.3
    points[..., 2] += 0.02 * torch.sin(19.0 * points[..., 0] + 7.0 * points[..., 1] + phase)
    env.unwrapped.forget_measurement()


# ---------------------------------------------------------------- which nodes


def test_a_bent_rope_is_bent_where_it_is_and_a_flat_sheet_nowhere():
    corner = torch.tensor([[[-2.0, 0, 0], [-1, 0, 0], [0, 0, 0], [0, 1, 0], [0, 2, 0]]])
    segments = torch.tensor([[[0, 1], [1, 2], [2, 3], [3, 4], [0, 0]]])  # the last is none
    angle = bend_angles(corner, segments)
    torch.testing.assert_close(angle, torch.tensor([[0.0, 0.0, np.pi / 4, 0.0, 0.0]]), atol=1e-3, rtol=0.0)
    square = torch.tensor([[[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]])
    faces = torch.tensor([[[0, 1, 2], [0, 2, 3]]])
    assert bend_angles(square, faces).max() < 1e-3
    square[0, 3, 2] = 1.0  # folded along the diagonal 0-2
    folded = bend_angles(square, faces)
    assert (folded[0, [0, 2]] > 0.3).all()
    assert (folded[0, [1, 3]] < 1e-3).all()


def test_each_keypoint_is_the_best_by_weight_and_distance():
    generator = torch.Generator().manual_seed(0)
    points = torch.rand(3, 12, 2, generator=generator)
    distances, weights = torch.cdist(points, points), torch.rand(3, 12, generator=generator) + 0.1
    allowed = torch.rand(3, 12, generator=generator) < 0.7
    nodes, found = choose_keypoints(weights, distances, allowed, 5)
    assert found.all()
    for world in range(3):
        assert int(nodes[world, 0]) == int((weights[world] * allowed[world]).argmax())
        for place in range(1, 5):
            nearest = distances[world][:, nodes[world, :place]].min(dim=1).values
            assert int(nodes[world, place]) == int((weights[world] * nearest * allowed[world]).argmax())


def test_fewer_nodes_than_keypoints_leave_some_unfound():
    distances = torch.cdist(torch.rand(1, 6, 2), torch.rand(1, 6, 2)).fill_(1.0) - torch.eye(6)
    allowed = torch.tensor([[True, False, True, False, False, False]])
    nodes, found = choose_keypoints(torch.ones(1, 6), distances, allowed, 4)
    assert found.tolist() == [[True, True, False, False]]
    assert set(nodes[0, :2].tolist()) == {0, 2}


def test_neighbours_are_those_with_nobody_between():
    generator = torch.Generator().manual_seed(1)
    points, mask = torch.rand(2, 9, 2, generator=generator), torch.ones(2, 9, dtype=torch.bool)
    mask[1, 4] = False
    distances = torch.cdist(points, points)
    neighbors = relative_neighbors(distances, mask)
    for world in range(2):
        for i in range(9):
            there = [m for m in range(9) if mask[world, m]]
            expected = {
                j
                for j in there
                if i in there
                and j != i
                and not any(max(distances[world, i, m], distances[world, m, j]) < distances[world, i, j] for m in there)
            }
            assert {j for j in neighbors[world, i].tolist() if j >= 0} == expected


def test_keypoints_of_a_rope_are_a_chain_from_end_to_end():
    env = gym.make("RopeShaping-v1", num_envs=2, sim_backend="cpu", render_backend="none", keypoints=6)
    graph = env.reset(seed=0)[0]["graph"]["object"]
    assert graph["position"].shape == (2, 6, 3)
    degrees = (graph["neighbors"] >= 0).sum(dim=-1)
    assert (degrees.sort(dim=1).values == torch.tensor([1, 1, 2, 2, 2, 2])).all()
    ends = env.unwrapped.solver.positions[:, [0, -1]]
    assert (torch.cdist(ends, graph["position"]).min(dim=2).values == 0.0).all()
    env.close()


def test_corners_are_there_and_what_is_shown_is_true(make_env):
    env = make_env(3, keypoints=8, shapes=["square"])
    bend(env)
    base, shown = env.unwrapped, keypoints(env)
    corners = np.flatnonzero(is_corner(base.model_of(0)))
    assert len(corners) == 4
    distance = torch.cdist(base.solver.positions[:, corners], shown["position"])
    assert (distance.min(dim=2).values == 0.0).all()
    full = make_env(3, shapes=["square"])
    bend(full)
    every = keypoints(full)
    node = torch.cdist(shown["position"], every["position"]).argmin(dim=2)
    rows = torch.arange(3)[:, None]
    for name in ("position", "vectors", "scalars"):
        assert torch.equal(shown[name], every[name][rows, node])
    base.graph_schema.validate(base.get_obs()["graph"], values=True)


def test_keypoints_move_with_the_scene(make_env):
    env = make_env(3, keypoints=8)
    bend(env)
    before = keypoints(env)
    env.unwrapped.move_worlds(ROTATION, torch.tensor([0.1, 0.2, 0.0]))
    after = keypoints(env)
    torch.testing.assert_close(after["position"], before["position"] @ ROTATION.T + torch.tensor([0.1, 0.2, 0.0]))
    assert torch.equal(after["neighbors"], before["neighbors"])


def test_hidden_nodes_are_no_keypoints(make_env):
    env = make_env(2, keypoints=10, **CAMERA)
    base = env.unwrapped
    base.solver.holder[:] = -1
    base.solver.gripper_positions[..., 0] = 2.0
    assert keypoints(env)["mask"].all()
    base.solver.positions[0, :, 0] += 5.0
    shown = keypoints(env)
    assert shown["mask"].any(dim=1).tolist() == [False, True]
    assert (shown["position"][0] == 0.0).all()


# ---------------------------------------------------------------- noise


def test_noise_moves_keypoints_by_what_was_asked_and_dropout_leaves_no_trace(make_env):
    exact = make_env(64, keypoints=8)
    noisy = make_env(64, keypoints=8, keypoint_noise=0.02, keypoint_dropout=0.25)
    truth, seen = keypoints(exact), keypoints(noisy)
    lost = ~seen["mask"]
    assert 0.18 < lost.float().mean() < 0.32
    assert (seen["position"][lost] == 0.0).all()
    assert (seen["scalars"][lost] == 0.0).all()
    error = (seen["position"] - truth["position"])[seen["mask"]]
    assert error.std() == pytest.approx(0.02, rel=0.08)
    assert error.mean().abs() < 0.002
    names = [channel.name for channel in exact.unwrapped.graph_schema.object.vectors]
    offset = names.index("goal_offset") if "goal_offset" in names else None
    if offset is not None:  # it starts at the node
        change = (seen["vectors"] - truth["vectors"])[..., offset, :][seen["mask"]]
        torch.testing.assert_close(change, -error, atol=1e-6, rtol=0.0)


def test_noise_is_that_of_the_episode_and_step_whatever_the_batch(make_env):
    options = {"keypoints": 8, "keypoint_noise": 0.02, "keypoint_dropout": 0.2}
    env, alone = make_env(3, **options), make_env(1, **options)
    env.reset(seed=[4, 5, 6])
    alone.reset(seed=[5])
    first = keypoints(env)
    assert all(torch.equal(first[name], keypoints(env)[name]) for name in first)  # asking twice
    assert torch.equal(first["position"][1], keypoints(alone)["position"][0])
    state = env.unwrapped.get_state_dict()
    later = env.step(torch.zeros(3, env.action_space.shape[-1]))[0]["graph"]["object"]
    assert not torch.equal(later["mask"], first["mask"]) or not torch.equal(later["position"], first["position"])
    env.reset(seed=[7, 8, 9])
    assert not torch.equal(keypoints(env)["position"], first["position"])
    env.unwrapped.set_state_dict(state)
    assert torch.equal(keypoints(env)["position"], first["position"])


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_policies_take_keypoints_as_they_are(make_env, name):
    env = make_env(2, keypoints=6, keypoint_dropout=0.5, critic_observations="full", **CAMERA)
    graph = env.unwrapped.get_obs()["graph"]
    env.unwrapped.graph_schema.validate(graph, values=True)
    torch.manual_seed(0)
    policy = make_policy(name, env.unwrapped.graph_schema)
    policy.normalizer.update(graph)
    distribution, value = policy(graph)
    assert torch.isfinite(distribution.mean).all()
    assert torch.isfinite(value).all()


# ---------------------------------------------------------------- the critic


@pytest.mark.parametrize("options", [{"keypoints": 6}, CAMERA, {**CAMERA, "hidden_nodes": "stale"}])
def test_the_critic_sees_what_a_full_graph_shows(make_env, options):
    env, full = make_env(2, critic_observations="full", **options), make_env(2)
    action = torch.full((2, env.action_space.shape[-1]), 0.4)
    graph, complete = (each.step(action)[0]["graph"] for each in (env, full))
    assert "critic" not in make_env(2, **options).unwrapped.get_obs()["graph"]
    for name in ("position", "vectors", "mask", "neighbors"):
        assert torch.equal(graph["critic"]["object"][name], complete["object"][name])
    width = complete["object"]["scalars"].shape[-1]
    assert torch.equal(graph["critic"]["object"]["scalars"][..., :width], complete["object"]["scalars"])
    assert torch.equal(graph["critic"]["actuator"]["position"], graph["actuator"]["position"])


@pytest.mark.parametrize("value_encoder", ["shared", "separate"])
def test_the_actor_does_not_see_the_critics_graph_and_the_value_sees_nothing_else(make_env, value_encoder):
    env = make_env(2, critic_observations="full", keypoints=6)
    graph = env.unwrapped.get_obs()["graph"]
    torch.manual_seed(0)
    policy = make_policy("grpd", env.unwrapped.graph_schema, value_encoder=value_encoder)
    policy.normalizer.update(graph)
    distribution, value = policy(graph)
    shown = {key: part for key, part in graph.items() if key != "critic"}
    moved = {**graph["critic"]["object"], "position": graph["critic"]["object"]["position"] * 1.3}
    other, other_value = policy({**graph, "critic": {**graph["critic"], "object": moved}})
    assert torch.equal(other.mean, distribution.mean)
    assert not torch.equal(other_value, value)
    torch.testing.assert_close(policy(graph["critic"])[1], value)
    torch.testing.assert_close(policy.value(graph), value)
    torch.testing.assert_close(policy.distribution(shown).mean, distribution.mean)


# ---------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"keypoints": 1}, "keypoints must be a whole number >= 2, got 1"),
        ({"keypoints": 3.0}, "keypoints must be a whole number"),
        ({"keypoints": 100_000}, r"keypoints must be in \[2, \d+\], the nodes of the smallest graph, got 100000"),
        ({"keypoints": 30, "graph_nodes": 20}, r"keypoints must be in \[2, 20\]"),
        ({"keypoint_noise": 0.1}, "need keypoints"),
        ({"keypoints": 4, "keypoint_noise": -0.1}, r"keypoint_noise must be a finite length >= 0 \[m\], got -0.1"),
        ({"keypoints": 4, "keypoint_dropout": 1.0}, r"keypoint_dropout must be in \[0, 1\), got 1.0"),
        ({"keypoints": 4, "obs_mode": "state"}, 'must have "graph"'),
        ({"keypoints": 4, "hidden_nodes": "stale", **CAMERA}, "found anew at every step"),
        ({"keypoints": 4, "graph_features": "rich"}, "grippers tell of all nodes"),
        ({"critic_observations": "full"}, 'needs visibility="camera" or keypoints'),
        ({"critic_observations": "all", "keypoints": 4}, r"must be one of \[None, 'full'\], got 'all'"),
    ],
)
def test_options_that_do_not_fit_are_refused(make_env, options, message):
    with pytest.raises(ValueError, match=message):
        make_env(1, **options)
