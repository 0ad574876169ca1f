"""Graphs that show only what cameras see."""

import pytest
import torch

from maniskill_grpd.policies import POLICIES, make_policy

ENV_ID = "ClothFolding-v1"
LOW = {"base_camera": {"width": 64, "height": 64, "pose": [0.0, -0.9, 0.25, 0.7071068, 0.0, 0.0, 0.7071068]}}
SIDE = {"sensor_configs": {"base_camera": {"width": 64, "height": 64}}}


def lay_folded(env):
    """Fold the cloth of every world in the middle: the half with larger x lies over the other."""
    solver = env.unwrapped.solver
    points = solver.positions
    middle = 0.5 * (points[..., 0].amin(1) + points[..., 0].amax(1))[:, None]
    upper = points[..., 0] > middle
    points[..., 0] = torch.where(upper, 2.0 * middle - points[..., 0], points[..., 0])
    points[..., 2] += torch.where(upper, 0.03, 0.0)
    solver.holder[:] = -1
    solver.gripper_positions[..., 0] = 2.0
    env.unwrapped.forget_measurement()
    return upper


def moved(env):
    return torch.full((env.unwrapped.num_envs, env.action_space.shape[-1]), 0.4)


def test_what_lies_below_is_masked_and_leaves_no_trace(make_env):
    env, full = (make_env(2, obs_mode="graph", **options) for options in ({"visibility": "camera", **SIDE}, {}))
    upper = lay_folded(env)
    lay_folded(full)
    graph, complete = (each.unwrapped.get_obs()["graph"]["object"] for each in (env, full))
    shown, known = graph["mask"], complete["mask"]
    assert (shown[upper & known]).float().mean() > 0.95
    assert (shown[~upper & known]).float().mean() < 0.3
    for name in ("position", "vectors", "scalars"):
        assert (graph[name][~shown] == 0.0).all()
        assert torch.equal(graph[name][shown], complete[name][shown])


def test_a_flat_cloth_is_seen_whole_and_one_out_of_the_image_not_at_all(make_env):
    env = make_env(2, obs_mode="graph", visibility="camera", **SIDE)
    base = env.unwrapped
    base.solver.holder[:] = -1
    base.solver.gripper_positions[..., 0] = 2.0
    assert torch.equal(base.get_obs()["graph"]["object"]["mask"], base.solver.node_mask)
    base.solver.positions[0, :, 0] += 5.0
    assert base.get_obs()["graph"]["object"]["mask"].any(dim=1).tolist() == [False, True]


def test_held_nodes_are_known(make_env):
    env = make_env(2, obs_mode="graph", visibility="camera", **SIDE)
    base = env.unwrapped
    held = base.solver.holder >= 0
    assert base.get_obs()["graph"]["object"]["mask"][held].all()
    base.solver.holder[:] = -1  # the balls of the grippers stay where they are
    assert not base.get_obs()["graph"]["object"]["mask"][held].any()


def test_a_stale_node_stays_where_it_was_seen_and_grows_older(make_env):
    env = make_env(2, obs_mode="graph", visibility="camera", hidden_nodes="stale", **SIDE)
    base = env.unwrapped
    assert [channel.name for channel in base.graph_schema.object.scalars][-1] == "age"
    base.solver.gripper_positions[..., 0] = 2.0
    before = base.get_obs()["graph"]["object"]
    assert before["mask"].all()
    assert (before["scalars"][..., -1] == 0.0).all()
    upper = lay_folded(env)
    after = base.get_obs()["graph"]["object"]
    again = base.get_obs()["graph"]["object"]
    assert all(torch.equal(after[name], again[name]) for name in after)
    has_moved = (after["position"] != before["position"]).any(dim=-1)
    assert has_moved[upper].float().mean() > 0.9
    assert has_moved[~upper].float().mean() < 0.3
    base._after_simulation_step()
    base._after_simulation_step()
    older = base.get_obs()["graph"]["object"]
    assert older["mask"].all()
    ages = older["scalars"][..., -1]
    hidden = ages > 0.0
    torch.testing.assert_close(ages[hidden], torch.full_like(ages[hidden], 0.1))
    assert hidden[~upper].float().mean() > 0.7
    assert hidden[upper].float().mean() < 0.1
    assert torch.equal(older["position"][hidden], before["position"][hidden])


def test_what_was_never_seen_is_masked_until_it_is(make_env):
    env = make_env(2, obs_mode="graph", visibility="camera", hidden_nodes="stale", **SIDE)
    base = env.unwrapped
    lay_folded(env)
    base._start_observing(torch.tensor([0]))
    mask = base.get_obs()["graph"]["object"]["mask"]
    assert 0.3 < mask[0].float().mean() < 0.8
    assert mask[1].float().mean() > mask[0].float().mean()


def test_the_memory_is_part_of_the_state(make_env):
    env = make_env(3, obs_mode="graph", visibility="camera", hidden_nodes="stale", **SIDE)
    for _ in range(4):
        env.step(moved(env))
    state = env.unwrapped.get_state_dict()
    expected = [env.step(moved(env))[0]["graph"]["object"] for _ in range(3)]
    env.reset(seed=9)
    env.unwrapped.set_state_dict(state)
    for graph in expected:
        restored = env.step(moved(env))[0]["graph"]["object"]
        assert all(torch.equal(restored[name], graph[name]) for name in graph)


@pytest.mark.parametrize("hidden_nodes", ["mask", "stale"])
def test_the_worlds_go_the_same_way_whatever_is_shown(make_env, hidden_nodes):
    plain = make_env(2, obs_mode="graph")
    seeing = make_env(2, obs_mode="graph", visibility="camera", hidden_nodes=hidden_nodes, **SIDE)
    for _ in range(3):
        expected, reward = plain.step(moved(plain))[1], seeing.step(moved(seeing))[1]
        assert torch.equal(expected, reward)
    assert torch.equal(plain.unwrapped.solver.positions, seeing.unwrapped.solver.positions)


@pytest.mark.parametrize("hidden_nodes", ["mask", "stale"])
@pytest.mark.parametrize("name", sorted(POLICIES))
def test_policies_take_partial_graphs_as_they_are(make_env, name, hidden_nodes):
    env = make_env(2, obs_mode="graph", visibility="camera", hidden_nodes=hidden_nodes, graph_nodes=20, **SIDE)
    graph = env.step(moved(env))[0]["graph"]
    env.unwrapped.graph_schema.validate(graph, values=True)
    torch.manual_seed(0)
    policy = make_policy(name, env.unwrapped.graph_schema)
    policy.normalizer.update(graph)
    distribution, value = policy(graph)
    assert torch.isfinite(distribution.mean).all()
    assert torch.isfinite(value).all()


def turned(env, with_camera):
    """Return the graphs before and after all worlds turn by 120 degrees, and the camera with them or not; and the rotation."""
    base = env.unwrapped
    lay_folded(env)
    base.solver.positions[..., 1] += 0.02 * torch.sin(20.0 * base.solver.positions[..., 0])
    before = base.get_obs()["graph"]
    cosine, sine = -0.5, 0.75**0.5
    rotation = torch.tensor([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    base.move_worlds(rotation, torch.zeros(3))
    if with_camera:
        for camera in base._sight._cameras:
            images = camera._rasterizer
            images.extrinsics[..., :3] = images.extrinsics[..., :3] @ rotation.T
    return before, base.get_obs()["graph"], rotation


def test_what_is_seen_moves_with_the_scene_only_if_the_camera_does(make_env):
    for with_camera in (True, False):
        env = make_env(3, obs_mode="graph", visibility="camera", sensor_configs=LOW)
        before, after = (graph["object"]["mask"] for graph in turned(env, with_camera=with_camera)[:2])
        assert 0.05 < before.float().mean() < 0.95
        agreement = (before == after).float().mean()
        assert agreement > 0.99 if with_camera else agreement < 0.95


@pytest.mark.parametrize("with_camera", [True, False])
def test_actions_turn_with_the_scene_only_if_the_camera_does(make_env, with_camera):
    env = make_env(3, obs_mode="graph", visibility="camera", sensor_configs=LOW)
    before, after, rotation = turned(env, with_camera=with_camera)
    torch.manual_seed(0)
    policy = make_policy("grpd", env.unwrapped.graph_schema)
    policy.normalizer.update(before)
    with torch.no_grad():
        action, later = (policy.distribution(graph).mean for graph in (before, after))
    difference = (later - action @ rotation.T).norm(dim=-1) / action.norm(dim=-1)
    assert difference.max() < 1e-3 if with_camera else difference.mean() > 0.01


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"visibility": "eye"}, r"visibility must be one of \[None, 'camera'\], got 'eye'"),
        ({"visibility": "camera", "hidden_nodes": "gone"}, r"hidden_nodes must be one of \['mask', 'stale'\], got 'gone'"),
        ({"hidden_nodes": "stale"}, 'needs visibility="camera"'),
        ({"visibility": "camera", "obs_mode": "depth"}, 'must have "graph"'),
        ({"visibility": "camera", "obs_mode": "state+graph"}, "tells where all nodes are"),
        ({"visibility": "camera", "graph_features": "rich"}, "grippers tell of all nodes"),
    ],
)
def test_options_that_do_not_fit_are_refused(make_env, options, message):
    with pytest.raises(ValueError, match=message):
        make_env(1, **options)


def test_a_task_without_a_camera_cannot_hide(make_env, monkeypatch):
    cls = type(make_env(1).unwrapped)
    monkeypatch.setattr(cls, "_default_sensor_configs", property(lambda self: []))
    with pytest.raises(ValueError, match="needs a camera"):
        make_env(1, visibility="camera")


def test_info_tells_what_share_is_hidden(make_env):
    env = make_env(2, visibility="camera", **SIDE)
    base = env.unwrapped
    base.solver.holder[:] = -1
    base.solver.positions[1, :, 0] += 5.0
    base.solver.gripper_positions[..., 0] = 2.0
    assert base.get_info()["hidden_share"].tolist() == [0.0, 1.0]
    lay_folded(env)
    mask, seen = base.solver.node_mask, base.get_obs()["graph"]["object"]["mask"]
    expected = 1.0 - seen.sum(dim=1) / mask.sum(dim=1)
    torch.testing.assert_close(base.get_info()["hidden_share"], expected)
    assert "hidden_share" not in make_env(1).unwrapped.get_info()
