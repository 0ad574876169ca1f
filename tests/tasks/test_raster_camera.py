"""ManiSkill's observation modes without SAPIEN."""

import pytest
import torch
from mani_skill.utils import sapien_utils
from mani_skill.utils.structs.pose import Pose
from mani_skill.utils.wrappers import FlattenRGBDObservationWrapper

from maniskill_grpd.graphs import point_schema, points_to_graph
from maniskill_grpd.rendering import Label
from maniskill_grpd.tasks.pictures import render_device

IMAGES = {
    "rgb": (3, torch.uint8),
    "depth": (1, torch.int16),
    "segmentation": (1, torch.int16),
    "position": (3, torch.int16),
    "normal": (3, torch.float32),
    "albedo": (3, torch.uint8),
}


@pytest.fixture(autouse=True)
def no_sapien(monkeypatch):
    """Let SAPIEN be unable to draw: nothing here may need it."""
    monkeypatch.setattr(render_device, "can_draw", lambda device: False)


def look_down(height=1.0):
    return sapien_utils.look_at(eye=[0.0, 0.0, height], target=[0.001, 0.0, 0.0])


@pytest.mark.parametrize("name", sorted(IMAGES))
def test_images_have_the_names_shapes_and_types_of_maniskill(make_env, name):
    env = make_env(3, obs_mode=name, render_backend="auto")
    assert env.unwrapped.backend.render_backend == "warp_cpu"
    obs = env.step(torch.zeros(3, 12))[0]
    assert set(obs) == {"agent", "extra", "sensor_data", "sensor_param"}
    images = obs["sensor_data"]["base_camera"]
    channels, dtype = IMAGES[name]
    assert set(images) == {name}
    assert images[name].shape == (3, 128, 128, channels)
    assert images[name].dtype == dtype
    assert (images[name][0] != images[name][1]).any()
    assert env.observation_space["sensor_data"]["base_camera"][name].shape == (3, 128, 128, channels)


@pytest.mark.parametrize(
    ("obs_mode", "keys"),
    [
        ("rgbd", {"agent", "extra", "sensor_data", "sensor_param"}),
        ("depth+segmentation+state", {"state", "sensor_data", "sensor_param"}),
        ("rgb+state_dict", {"agent", "extra", "sensor_data", "sensor_param"}),
        ("graph+depth", {"agent", "extra", "graph", "sensor_data", "sensor_param"}),
        ("graph+pointcloud", {"agent", "extra", "graph", "pointcloud", "sensor_data", "sensor_param"}),
    ],
)
def test_modes_are_joined(make_env, obs_mode, keys):
    env = make_env(2, obs_mode=obs_mode)
    obs = env.step(torch.zeros(2, 12))[0]
    assert set(obs) == keys
    for word in set(obs_mode.split("+")) & set(IMAGES):
        assert word in obs["sensor_data"]["base_camera"]
    if "graph" in obs:
        env.unwrapped.graph_schema.validate(obs["graph"], values=True)


def test_the_graph_is_the_same_with_images_and_without(make_env):
    plain, seeing = make_env(2), make_env(2, obs_mode="graph+rgb")
    for _ in range(3):
        action = torch.full((2, 12), 0.3)
        expected, graph = plain.step(action)[0]["graph"], seeing.step(action)[0]["graph"]
        for node in ("object", "actuator"):
            assert all(torch.equal(expected[node][key], graph[node][key]) for key in expected[node])


def test_raw_textures_are_those_of_the_minimal_shader(make_env):
    obs = make_env(2, obs_mode="sensor_data").unwrapped.get_obs()
    images = obs["sensor_data"]["base_camera"]
    assert {name: (image.shape, image.dtype) for name, image in images.items()} == {
        "Color": ((2, 128, 128, 4), torch.uint8),
        "PositionSegmentation": ((2, 128, 128, 4), torch.int16),
    }


def test_points_lie_on_the_rope_and_the_table(make_env):
    env = make_env(2, obs_mode="pointcloud")
    base, cloud = env.unwrapped, env.unwrapped.get_obs()["pointcloud"]
    assert cloud["xyzw"].shape == (2, 128 * 128, 4)
    assert cloud["rgb"].shape == (2, 128 * 128, 3)
    assert cloud["segmentation"].shape == (2, 128 * 128, 1)
    for world in range(2):
        label = cloud["segmentation"][world, :, 0]
        points, weight = cloud["xyzw"][world, :, :3], cloud["xyzw"][world, :, 3]
        assert torch.equal(weight, (label != Label.NONE).float())
        # Not rounded to millimetres, as ManiSkill's are.
        assert points[label == Label.TABLE][:, 2].abs().max() < 1e-5
        rope, radius = points[label == Label.ROPE], base.solver.model.radius
        assert len(rope) > 50
        distance = torch.cdist(rope, base.solver.positions[world]).min(dim=1).values
        assert distance.max() < radius + 0.5 * base.solver.model.rest_lengths.max()
        assert distance.min() > 0.9 * radius
        assert (rope[:, 2] > base.solver.positions[world, :, 2].min()).float().mean() > 0.9  # seen from above


def test_parameters_take_the_world_to_the_pixels(make_env):
    env = make_env(2, obs_mode="position+segmentation", sensor_configs={"width": 160, "height": 96})
    obs = env.unwrapped.get_obs()
    images, params = obs["sensor_data"]["base_camera"], obs["sensor_param"]["base_camera"]
    assert {name: value.shape for name, value in params.items()} == {
        "extrinsic_cv": (2, 3, 4),
        "cam2world_gl": (2, 4, 4),
        "intrinsic_cv": (2, 3, 3),
    }
    assert images["position"].shape == (2, 96, 160, 3)
    local = torch.nn.functional.pad(images["position"].float() / 1000.0, (0, 1), value=1.0)
    points = local @ params["cam2world_gl"][0].T
    seen = points @ params["extrinsic_cv"][0].T
    pixels = seen @ params["intrinsic_cv"][0].T
    pixels = pixels[..., :2] / pixels[..., 2:]
    rows, columns = torch.meshgrid(torch.arange(96) + 0.5, torch.arange(160) + 0.5, indexing="ij")
    known = images["segmentation"][0, ..., 0] != 0
    # Positions are whole millimetres: a tenth of a pixel here.
    assert (pixels[0] - torch.stack([columns, rows], dim=-1))[known].abs().max() < 0.15


def test_cameras_stand_where_their_poses_say_as_those_of_sapien_do(make_env):
    """A camera of SAPIEN looks along the x-axis of its pose, y is left and z up."""
    poses = Pose.create_from_pq(p=torch.tensor([[0.0, 0.0, 0.5], [0.3, 0.0, 0.5]]), q=look_down().q)
    env = make_env(2, obs_mode="depth", sensor_configs={"base_camera": {"pose": poses}}, render_backend="warp")
    obs = env.unwrapped.get_obs()
    extrinsic = obs["sensor_param"]["base_camera"]["extrinsic_cv"]
    point = torch.tensor([0.1, 0.2, 0.0, 1.0])
    x, y, z = (extrinsic @ point).unbind(1)
    torch.testing.assert_close(z, torch.tensor([0.5, 0.5]), atol=2e-3, rtol=0.0)
    world = poses.inv() * Pose.create_from_pq(p=point[None, :3].expand(2, 3))
    torch.testing.assert_close(torch.stack([z, -x, -y], dim=1), world.p)
    depth = obs["sensor_data"]["base_camera"]["depth"]
    assert abs(int(depth[0, -1, -1]) - 500) <= 3


def test_a_camera_can_be_carried_by_a_gripper(make_env):
    pose = look_down(0.5)
    settings = {"base_camera": {"entity_uid": "gripper_1", "pose": pose, "width": 32, "height": 32, "fov": 0.3}}
    env = make_env(2, obs_mode="position+segmentation", sensor_configs=settings)
    base = env.unwrapped
    for _ in range(2):
        obs = base.get_obs()
        params = obs["sensor_param"]["base_camera"]["cam2world_gl"]
        expected = base.solver.gripper_positions[:, 1] + torch.tensor([0.0, 0.0, 0.5])
        torch.testing.assert_close(params[:, :3, 3], expected)
        height = obs["sensor_data"]["base_camera"]["position"][:, -1, -1, 2].float() / -1000.0
        torch.testing.assert_close(height, expected[:, 2], atol=3e-3, rtol=0.0)
        env.step(torch.full((2, 12), 0.8))


def test_images_follow_the_worlds_and_are_copies(make_env):
    env = make_env(2, obs_mode="depth")
    first = env.unwrapped.get_obs()["sensor_data"]["base_camera"]["depth"]
    kept = first.clone()
    env.step(torch.full((2, 12), 0.8))
    second = env.unwrapped.get_obs()["sensor_data"]["base_camera"]["depth"]
    assert torch.equal(first, kept)
    assert not torch.equal(first, second)


def test_wrappers_of_maniskill_take_the_images(make_env):
    env = FlattenRGBDObservationWrapper(make_env(2, obs_mode="rgb+depth+state"), rgb=True, depth=True, state=True)
    obs = env.reset(seed=0)[0]
    assert obs["rgb"].shape == (2, 128, 128, 3)
    assert obs["depth"].shape == (2, 128, 128, 1)
    assert obs["state"].shape[0] == 2


@pytest.mark.parametrize(("render_mode", "width"), [("sensors", 128), ("all", 128 + 512)])
def test_what_cameras_see_can_be_shown(make_env, render_mode, width):
    images = make_env(2, render_mode=render_mode).render()
    assert images.shape[0] == 2
    assert images.shape[2:] == (width, 3)


# ---------------------------------------------------------------- bad input


@pytest.mark.parametrize(
    ("configs", "message"),
    [
        ({"wrist": {"width": 8}}, r"\['wrist'\]; allowed are the cameras \['base_camera'\]"),
        ({"base_camera": {"size": 8}}, r"\['size'\]; allowed are"),
        ({"width": 0}, "width must be a whole number in 1 ... 4096"),
        ({"height": 100000}, "height must be a whole number in 1 ... 4096"),
        ({"fov": 4.0}, "between 0 and pi"),
        ({"near": 3.0, "far": 1.0}, "near and far"),
        ({"entity_uid": "hand"}, r"can be mounted on \['gripper_0', 'gripper_1', 'gripper_2', 'gripper_3'\], got 'hand'"),
    ],
)
def test_impossible_cameras_are_refused(make_env, configs, message):
    with pytest.raises(ValueError, match=message):
        make_env(1, obs_mode="depth", sensor_configs=configs)


def test_images_that_do_not_fit_into_memory_are_refused(make_env):
    with pytest.raises(ValueError, match="100 worlds x 1 cameras of 4000x4000 pixels would take 11.9 GiB"):
        make_env(100, obs_mode="depth", sensor_configs={"width": 4000, "height": 4000})


def test_a_point_cloud_becomes_a_graph_of_the_rope(make_env):
    base = make_env(2, obs_mode="pointcloud").unwrapped
    cloud, solver = base.get_obs()["pointcloud"], base.solver
    graph = points_to_graph(
        cloud["xyzw"][..., :3],
        cloud["segmentation"][..., 0] == Label.ROPE,
        solver.gripper_positions,
        solver.closed,
        solver.gravity,
        schema=point_schema(length_scale=0.8, edge_length=0.04),
        num_nodes=20,
    )
    nearest = torch.cdist(solver.positions, graph["object"]["position"]).min(dim=2).values
    assert nearest.max() < 0.06
    assert graph["object"]["mask"].all()


def test_a_depth_sensor_errs_in_depths_and_points_alike_and_only_there(make_env):
    settings = {"obs_mode": "depth+position+rgb+segmentation", "sensor_configs": {"width": 32, "height": 32}}
    exact, noisy = make_env(2, **settings), make_env(2, depth_sensor={"noise": 0.05, "dropout": 0.2}, **settings)
    truth, seen = (env.unwrapped.get_obs()["sensor_data"]["base_camera"] for env in (exact, noisy))
    again = noisy.unwrapped.get_obs()["sensor_data"]["base_camera"]
    assert all(torch.equal(seen[name], again[name]) for name in seen)
    assert torch.equal(seen["rgb"], truth["rgb"])
    assert torch.equal(seen["segmentation"], truth["segmentation"])
    known = truth["depth"] > 0
    assert (seen["depth"][known] == 0).float().mean() == pytest.approx(0.2, abs=0.05)
    assert (seen["depth"] != truth["depth"])[known].float().mean() > 0.9
    assert (-seen["position"][..., 2:] - seen["depth"]).abs().max() <= 1  # both are rounded
    later = noisy.step(torch.zeros(2, 12))[0]["sensor_data"]["base_camera"]["depth"]
    assert ((later == 0) != (seen["depth"] == 0)).any()
    with pytest.raises(ValueError, match="depth_sensor must be a mapping"):
        make_env(1, depth_sensor={"blur": 1.0})


def test_a_camera_inside_something_is_refused_with_its_worlds(make_env):
    env = make_env(2)
    place = env.unwrapped.solver.gripper_positions[1, 0].tolist()
    settings = {"base_camera": {"pose": [*place, 1.0, 0.0, 0.0, 0.0]}}
    with pytest.raises(ValueError, match=r"camera 'base_camera' is inside an obstacle, a gripper or the rope in worlds"):
        make_env(2, obs_mode="depth", sensor_configs=settings).reset(seed=0)


def test_several_cameras_stand_round_the_table(make_env):
    env = make_env(1, obs_mode="depth", num_cameras=3, sensor_configs={"width": 16, "height": 16})
    params = env.unwrapped.get_sensor_params()
    assert list(params) == ["base_camera", "base_camera_1", "base_camera_2"]
    places = torch.cat([camera["cam2world_gl"][:, :3, 3] for camera in params.values()])
    assert (places[:, 2] - places[0, 2]).abs().max() < 1e-5
    target = torch.tensor(env.unwrapped.CAMERA_TARGET)
    torch.testing.assert_close((places - target)[:, :2].sum(dim=0), torch.zeros(2), atol=1e-5, rtol=0.0)
    axes = torch.cat([-camera["cam2world_gl"][:, :3, 2] for camera in params.values()])
    torch.testing.assert_close(axes, torch.nn.functional.normalize(target - places), atol=1e-5, rtol=0.0)
    with pytest.raises(ValueError, match=r"num_cameras must be a whole number in 1 ... 8, got 9"):
        make_env(1, num_cameras=9)


def test_a_camera_can_be_on_the_hand_of_an_arm(make_env):
    arms = {"num_grippers": 2, "robot_uids": ("panda", "panda"), "pose_range": "quarter"}
    mount = {"base_camera": {"entity_uid": "arm_1/panda_hand", "pose": [0.1, 0.0, 0.0, 0.7071068, 0.0, -0.7071068, 0.0]}}
    env = make_env(1, obs_mode="depth", sensor_configs={"width": 16, "height": 16, **mount}, **arms)
    before = env.unwrapped.get_sensor_params()["base_camera"]["cam2world_gl"][0]
    grippers = env.unwrapped.solver.gripper_positions[0].clone()
    assert (before[:3, 3] - grippers[1]).norm() < 0.3
    actions = {key: torch.ones(1, space.shape[-1]) for key, space in env.action_space.items()}
    for _ in range(3):
        env.step(actions)
    after = env.unwrapped.get_sensor_params()["base_camera"]["cam2world_gl"][0]
    moved = env.unwrapped.solver.gripper_positions[0, 1] - grippers[1]
    assert moved.norm() > 0.02
    torch.testing.assert_close(after[:3, 3] - before[:3, 3], moved, atol=0.02, rtol=0.0)
    with pytest.raises(ValueError, match="can be mounted on .*arm_0/panda_hand.*got 'arm_7/nose'"):
        make_env(1, obs_mode="depth", sensor_configs={"base_camera": {"entity_uid": "arm_7/nose"}}, **arms)
