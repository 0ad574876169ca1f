"""Pictures with and without SAPIEN."""

import dataclasses
import urllib.error
import urllib.request

import gymnasium as gym
import numpy as np
import pytest
import torch
import trimesh

from maniskill_grpd.rendering import extrinsic_from_pose, intrinsic_from_fov, palette
from maniskill_grpd.tasks.pictures import render_device
from maniskill_grpd.tasks.pictures.drawing import Drawing, Line, Sheet, Solid, Tube
from maniskill_grpd.tasks.pictures.render_device import choose_render_device
from maniskill_grpd.tasks.pictures.warp_painter import WarpPainter


@pytest.fixture
def no_renderer(monkeypatch):
    """Let no device be able to draw."""
    monkeypatch.setattr(render_device, "can_draw", lambda device: False)


@pytest.fixture(scope="module")
def renderer():
    """Skip tests where SAPIEN cannot draw; trying takes a second."""
    device = choose_render_device("auto", "rgb_array", "none")
    if device is None:
        pytest.skip("SAPIEN finds no device on which it can draw")
    return device


def grid_sheet(center=(0.0, 0.0, 0.003), side=0.4):
    """Return a square sheet of 15 x 15 vertices, front up."""
    x, y = np.meshgrid(np.linspace(-side / 2, side / 2, 15), np.linspace(-side / 2, side / 2, 15))
    vertices = np.stack([x, y, 0 * x], axis=-1).reshape(-1, 3) + center
    corner = (15 * np.arange(14)[:, None] + np.arange(14)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 16], corner[:, None] + [0, 16, 15]])
    return Sheet(vertices, faces)


def post(x=0.0, y=0.0, height=0.2):
    """Return an upright cylinder on the table."""
    mesh = trimesh.creation.cylinder(radius=0.02, height=height)
    return Solid(mesh.vertices + [x, y, height / 2], mesh.faces)


def cloth_drawing(**changes):
    """Return a drawing of a cloth with two grippers, the second open, a goal, a post and a line."""
    given = {
        "object": grid_sheet(),
        "goal": grid_sheet((0.25, 0.15, 0.003), 0.3),
        "solids": (post(-0.3, 0.1),),
        "lines": (Line(np.array([[-0.4, -0.3, 0.004], [0.0, -0.3, 0.004]])),),
        "grippers": np.array([[-0.2, -0.2, 0.01], [0.2, -0.2, 0.01]]),
        "closed": np.array([True, False]),
        "is_solved": False,
    }
    return Drawing(**(given | changes))


def colors(image):
    """Return masks of the orange, yellow, blue, green and dark pixels of an image (H, W, 3)."""
    red, green, blue = image.numpy().astype(int).transpose(2, 0, 1)
    return {
        "rope": (red > green + 75) & (red > blue + 60),
        "back": (red > green) & (green > blue + 60) & (red < green + 75),
        "goal": (blue > red + 25) & (blue > green + 10),
        "solved": (green > red + 30) & (green > blue + 20),
        "dark": (red < 50) & (green < 60) & (blue < 110),
    }


# ---------------------------------------------------------------- without SAPIEN


@pytest.mark.parametrize(("num_envs", "num_pictures", "size"), [(1, 1, 512), (4, 4, 512), (5, 5, 256), (20, 16, 256)])
def test_each_world_has_its_picture_in_the_size_of_a_tile(make_env, num_envs, num_pictures, size):
    env = make_env(num_envs, render_mode="rgb_array")
    images = env.render()
    assert images.shape == (num_pictures, size, size, 3)
    assert images.dtype == torch.uint8
    assert all((images[0] != image).any() for image in images[1:])
    assert not env.unwrapped.scene.actors


def test_pictures_show_rope_goal_and_success(make_env):
    env = make_env(2, render_mode="rgb_array")
    base = env.unwrapped
    base.solver.positions[1] = base.goal_positions[1]
    before, after = (colors(image) for image in env.render())
    for seen in (before, after):
        assert seen["rope"].mean() > 0.003
    assert before["goal"].mean() > 0.003
    assert before["solved"].mean() == 0.0
    assert after["solved"].mean() > 0.002


def test_solved_worlds_have_a_green_frame(make_env):
    env = make_env(2, render_mode="rgb_array")
    base = env.unwrapped
    base.solver.positions[1] = base.goal_positions[1]
    edges = [torch.cat([image[0], image[-1], image[:, 0], image[:, -1]])[None] for image in env.render()]
    assert [colors(edge)["solved"].mean() for edge in edges] == [0.0, 1.0]


def test_rope_is_drawn_where_the_camera_sees_it(make_env):
    env = make_env(1, render_mode="rgb_array")
    base = env.unwrapped
    x = torch.linspace(-0.4, 0.4, 41)
    base.solver.positions[0] = torch.stack([x, 0 * x, 0 * x + 0.01], dim=1)
    rows, columns = np.nonzero(colors(env.render()[0])["rope"])
    # x of the world is x of the picture; the camera looks at (0, -0.05, 0), a little below the rope
    assert np.ptp(rows) < 20
    assert np.ptp(columns) > 300
    assert abs(columns.mean() - 255.5) < 3
    assert 220 < rows.mean() < 256


def test_whole_workspace_is_in_the_picture(make_env):
    env = make_env(1, render_mode="rgb_array")
    camera = env.unwrapped._default_human_render_camera_configs
    matrix = intrinsic_from_fov(camera.fov, camera.width, camera.height) @ extrinsic_from_pose(
        camera.pose.to_transformation_matrix()[0]
    )
    yaw = torch.linspace(0.0, 2.0 * torch.pi, 100)
    for centre in ([x, y] for x in (-0.15, 0.15) for y in (-0.15, 0.15)):
        ends = torch.tensor(centre) + 0.4 * torch.stack([yaw.cos(), yaw.sin()], dim=1)
        seen = torch.cat([ends, torch.tensor([[0.0, 1.0]]).expand(100, 2)], dim=1) @ matrix.T
        pixels = seen[:, :2] / seen[:, 2:]
        assert (pixels > 5).all()
        assert (pixels < 507).all()


@pytest.fixture(scope="module")
def pictures():
    """Return a function that draws without SAPIEN what the default camera sees, (H, W, 3)."""
    base = gym.make("RopeShaping-v1", sim_backend="cpu", render_backend="none").unwrapped
    painter = WarpPainter(base._default_human_render_camera_configs)
    base.close()

    def draw(drawing, **options):
        painter.show(drawing, **options)
        return painter.picture()[0]

    return draw


def test_a_picture_does_not_depend_on_those_before(pictures):
    """Only what was drawn upon is wiped."""
    drawings = [
        cloth_drawing(),
        cloth_drawing(has_table=False),
        cloth_drawing(object=grid_sheet((0.3, 0.2, 0.2), 0.1), goal=None, lines=(), is_solved=True),
        cloth_drawing(object=grid_sheet((5.0, 5.0, 0.0))),  # out of sight
        cloth_drawing(object=grid_sheet((0.0, -0.7, 1.15), 0.5)),  # around the camera
    ]
    first = [pictures(drawing) for drawing in drawings]
    for index in (0, 1, 0, 2, 3, 4, 0, 4, 1, 2, 0):
        assert torch.equal(pictures(drawings[index]), first[index]), index
    env = gym.make("RopeShaping-v1", sim_backend="cpu", render_backend="none")
    for drawing, picture in zip(drawings, first, strict=True):
        painter = WarpPainter(env.unwrapped._default_human_render_camera_configs)
        painter.show(drawing)
        assert torch.equal(painter.picture()[0], picture)
    env.close()


def test_cloth_has_a_front_and_a_back(pictures):
    upright = grid_sheet()
    turned = Sheet(upright.vertices, upright.faces[:, ::-1])
    for sheet, seen, unseen in ((upright, "rope", "back"), (turned, "back", "rope")):
        image = colors(pictures(cloth_drawing(object=sheet)))
        assert image[seen].mean() > 0.05
        assert image[unseen].mean() == 0.0


def test_what_is_nearer_hides_what_is_further(pictures):
    bare = {"goal": None, "lines": (), "grippers": np.zeros((0, 3)), "closed": np.zeros(0, bool), "has_table": False}
    below, above = (cloth_drawing(object=grid_sheet((0.0, 0.0, z)), solids=(post(),), **bare) for z in (0.003, 0.25))
    is_grey = [np.abs(pictures(drawing).numpy().astype(int) - (110, 120, 130)).max(axis=-1) < 50 for drawing in (below, above)]
    assert is_grey[0].sum() > 400
    assert is_grey[1].sum() == 0


def test_a_goal_behind_the_cloth_shows_its_outline_alone(pictures):
    covered = cloth_drawing(goal=grid_sheet((0.0, 0.0, 0.003), 0.2), lines=())
    with_goal = pictures(covered).numpy().astype(int)
    change = np.abs(with_goal - pictures(covered, hide_goal=True).numpy()).max(axis=-1) > 8
    rows, columns = np.nonzero(change)
    assert 0 < change.sum() < 0.35 * np.ptp(rows) * np.ptp(columns)


def test_goal_and_lines_are_hidden_from_observations(pictures):
    drawing = cloth_drawing()
    bare = dataclasses.replace(drawing, goal=None, lines=())
    assert not torch.equal(pictures(drawing), pictures(bare))
    assert torch.equal(pictures(drawing, hide_goal=True), pictures(bare))


def test_closed_grippers_are_dark_and_open_ones_bright(pictures):
    num_dark = [
        colors(pictures(cloth_drawing(closed=np.array(closed))))["dark"].sum()
        for closed in ([False, False], [True, False], [True, True])
    ]
    assert num_dark[0] == 0
    assert num_dark[1] > 50
    assert num_dark[2] == pytest.approx(2 * num_dark[1], rel=0.2)


def test_a_world_without_a_table_has_none_and_no_shadows(pictures):
    image = pictures(cloth_drawing(has_table=False, goal=None, lines=())).numpy().astype(int)
    background = (np.abs(image - np.round(255 * np.array(palette.BACKGROUND))) <= 1).all(axis=-1)
    assert background.mean() > 0.8
    # At soft edges, colours mix.
    assert (np.abs(image - np.round(255 * np.array(palette.TABLE))) <= 6).all(axis=-1).mean() < 0.001


def test_what_is_lifted_throws_its_shadow_beside_itself(pictures):
    flat = cloth_drawing(goal=None, solids=(), lines=(), grippers=np.zeros((0, 3)), closed=np.zeros(0, bool))
    lifted = dataclasses.replace(flat, object=grid_sheet((0.0, 0.0, 0.2)))
    table = np.round(255 * np.array(palette.TABLE))
    dark = [(pictures(drawing).numpy() < 0.85 * table).all(axis=-1).sum() for drawing in (flat, lifted)]
    assert dark[1] > 4 * dark[0] > 0


def test_size_of_the_picture_can_be_chosen(make_env):
    env = make_env(1, render_mode="rgb_array", human_render_camera_configs={"width": 160, "height": 128})
    assert env.render().shape == (1, 128, 160, 3)


def test_pictures_do_not_change_afterwards(make_env):
    env = make_env(1, render_mode="rgb_array")
    first = env.render()
    kept = first.clone()
    env.step(torch.full((1, 12), 0.5))
    assert not torch.equal(env.render(), kept)
    assert torch.equal(first, kept)


def test_nothing_is_built_or_probed_when_nothing_is_drawn(make_env, monkeypatch):
    monkeypatch.setattr(render_device, "can_draw", lambda device: pytest.fail("probed"))
    env = make_env(2, render_backend="auto")
    assert env.unwrapped.backend.render_backend == "none"
    assert not env.unwrapped.scene.can_render()
    assert env.unwrapped._painter is None


@pytest.mark.usefixtures("no_renderer")
@pytest.mark.parametrize("requested", ["auto", "gpu", "cpu", "none", None])
def test_rgb_array_works_without_a_renderer(make_env, requested):
    env = make_env(1, render_mode="rgb_array", render_backend=requested)
    assert env.render().shape == (1, 512, 512, 3)


@pytest.mark.usefixtures("no_renderer")
def test_where_sapien_cannot_draw_a_browser_shows_the_worlds(make_env):
    pytest.importorskip("viser", reason="the viewer needs viser")
    env = make_env(2, render_mode="human")
    env.reset(seed=[1, 2])
    window = env.render()
    page = urllib.request.urlopen(window.address, timeout=10.0).read()
    assert window.address.startswith("http://127.0.0.1:")
    assert b"<html" in page.lower()
    assert env.render() is window
    env.close()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(window.address, timeout=1.0)


def test_probe_survives_a_crashing_driver_and_remembers(monkeypatch):
    monkeypatch.setattr(render_device, "_PROBE", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    assert not render_device.can_draw("a device that crashes")
    monkeypatch.setattr(render_device, "_PROBE", "raise SystemExit(0)")
    assert not render_device.can_draw("a device that crashes")
    assert render_device.can_draw("a device that works")


def test_probe_gives_up_on_a_driver_that_hangs(monkeypatch):
    monkeypatch.setattr(render_device, "_PROBE", "import time; time.sleep(60)")
    monkeypatch.setattr(render_device, "PROBE_TIMEOUT", 0.2)
    assert not render_device.can_draw("a device that hangs")


def test_render_backends_are_tried_in_order(monkeypatch):
    tried = []
    monkeypatch.setattr(render_device, "can_draw", lambda device: tried.append(device) or device == "cpu")
    assert choose_render_device("auto", "rgb_array", "none") == "cpu"
    assert tried == ["cuda", "cpu"]
    assert choose_render_device("sapien_cpu", None, "rgb") == "cpu"
    assert choose_render_device("auto", "human", "rgb") == "cpu"
    del tried[:]
    # SAPIEN draws one world after the other: not observations, unless it is asked to.
    assert [choose_render_device(name, "rgb_array", "rgb") for name in ("auto", "warp", "none", None)] == [None] * 4
    assert choose_render_device("warp", "rgb_array", "none") is None
    assert tried == []
    assert choose_render_device("gpu", "rgb_array", "none") is None
    assert choose_render_device("sapien_cuda:1", "rgb_array", "none") is None
    assert tried[-2:] == ["cuda", "cuda:1"]


# ---------------------------------------------------------------- with SAPIEN


def test_sapien_pictures_show_rope_goal_and_success(make_env, renderer):
    env = make_env(2, render_mode="rgb_array", render_backend=renderer)
    base = env.unwrapped
    assert base.scene.can_render()
    base.solver.positions[1] = base.goal_positions[1]
    images = env.render()
    assert images.shape == (2, 512, 512, 3)
    assert images.dtype == torch.uint8
    before, after = (colors(image) for image in images)
    assert before["rope"].mean() > 0.002
    assert before["goal"].mean() > 0.002
    assert before["solved"].mean() == 0.0
    assert after["solved"].mean() > 0.002
    assert set(base.get_state_dict()) == {"articulations", "controller", "solver", "episode"}


def test_both_painters_agree(make_env, renderer):
    images = [make_env(1, render_mode="rgb_array", render_backend=backend).render()[0] for backend in (renderer, "none")]
    centres = [np.argwhere(colors(image)["rope"]).mean(axis=0) for image in images]
    np.testing.assert_allclose(centres[0], centres[1], atol=4)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"object": Tube(np.array([[-0.3, 0.0, 0.01], [0.0, 0.1, 0.1], [0.3, 0.0, 0.01]]), 0.01), "goal": None},
        {"object": Sheet(grid_sheet().vertices, grid_sheet().faces[:, ::-1]), "is_solved": True},
        {"has_table": False, "solids": ()},
    ],
)
def test_both_painters_draw_the_same(make_env, renderer, pictures, changes, monkeypatch):
    env = make_env(1, render_mode="rgb_array", render_backend=renderer)
    drawing = cloth_drawing(**changes)
    monkeypatch.setattr(env.unwrapped, "drawing", lambda world: dataclasses.replace(drawing, is_solved=False))
    ours = pictures(dataclasses.replace(drawing, is_solved=False)).numpy().astype(int)
    theirs = env.render()[0].cpu().numpy().astype(int)
    # Light differs by a little everywhere, by much at edges, in soft shadows and where outlines shine through.
    assert (np.abs(ours - theirs).max(axis=-1) > 60).mean() < 0.01
    assert np.abs(ours - theirs).mean() < 12


def test_observations_show_neither_goal_nor_lines(make_env, renderer, monkeypatch):
    env = make_env(1, obs_mode="rgb", render_backend=renderer)
    seen = []
    for drawing in (cloth_drawing(), cloth_drawing(goal=None, lines=()), cloth_drawing(solids=())):
        monkeypatch.setattr(env.unwrapped, "drawing", lambda world, drawing=drawing: drawing)
        seen.append(env.unwrapped.get_obs()["sensor_data"]["base_camera"]["rgb"])
    assert torch.equal(seen[0], seen[1])
    assert not torch.equal(seen[0], seen[2])


@pytest.mark.parametrize("obs_mode", ["rgb+graph", "rgb+depth+segmentation+state", "pointcloud"])
def test_image_observations_of_each_world(make_env, renderer, obs_mode):
    env = make_env(2, obs_mode=obs_mode, render_backend=renderer)
    obs = env.step(torch.zeros(2, 12))[0]
    assert ("graph" in obs) == ("graph" in obs_mode)
    assert ("state" in obs) == ("state" in obs_mode)
    if obs_mode == "pointcloud":
        assert obs["pointcloud"]["xyzw"].shape == (2, 128 * 128, 4)
        return
    images = obs["sensor_data"]["base_camera"]["rgb"]
    assert images.shape == (2, 128, 128, 3)
    assert (images[0] != images[1]).any()
    assert obs["sensor_param"]["base_camera"]["extrinsic_cv"].shape[0] == 2
    assert env.unwrapped.get_sensor_images()["base_camera"]["rgb"].shape == (2, 128, 128, 3)


@pytest.mark.parametrize("render_mode", ["sensors", "all"])
def test_other_render_modes(make_env, renderer, render_mode):
    env = make_env(2, render_mode=render_mode, render_backend=renderer)
    images = env.render()
    assert images.shape[0] == 2
    assert images.shape[-1] == 3
