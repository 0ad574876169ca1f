"""ClothFolding-v1 keeps what its task card promises."""

import gc
import math

import gymnasium as gym
import mani_skill.envs  # noqa: F401
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.tasks import ClothFoldingEnv
from maniskill_grpd.tasks.observation.node_statistics import mean_over_nodes


@pytest.fixture
def make_folding(monkeypatch):
    """Return a function that makes ClothFolding-v1 on the CPU, reset with seed 0."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    made = []

    def make(num_envs=3, **options):
        made.append(gym.make("ClothFolding-v1", num_envs=num_envs, sim_backend="cpu", render_backend="none", **options))
        made[-1].reset(seed=0)
        return made[-1]

    yield make
    for env in made:
        env.close()


def frames_of_squares(base):
    """Return centres (B, 2), yaws (B,) and corners (B, 4, 2) of square cloths that lie flat."""
    corners = base.solver.positions[:, torch.as_tensor(base.models[0].node_sets["corners"]), :2]
    along = corners[:, 1] - corners[:, 0]
    return corners.mean(dim=1), torch.atan2(along[:, 1], along[:, 0]), corners


def creases_of_squares(base):
    """Return the directions of the normals in the frame of the cloth (B,) [rad] and the moving shares of the area (B,)."""
    _, yaw, corners = frames_of_squares(base)
    normal = base.crease_normal[:, :2]
    angle = torch.atan2(normal[:, 1], normal[:, 0]) - yaw
    heights = ((corners - base.crease_ends[:, :1, :2]) * normal[:, None]).sum(-1)
    shares = []
    for height, corner in zip(heights.double().numpy(), corners.double().numpy(), strict=True):
        part = []
        for index in range(4):
            first, second = height[index], height[index - 3]
            if first > 0:
                part.append(corner[index])
            if (first > 0) != (second > 0):
                part.append(corner[index] + first / (first - second) * (corner[index - 3] - corner[index]))
        x, y = np.array(part).T
        shares.append(0.5 * abs(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)) / 0.0576)
    return angle, torch.tensor(shares)


def fills(values, low, high):
    """Whether 500 uniform draws keep to their range and fill it; their mean is 4 sigma off at most."""
    span = high - low
    inside = bool((values >= low - 1e-3 * span).all() and (values <= high + 1e-3 * span).all())
    return (
        inside
        and values.min() < low + 0.03 * span
        and values.max() > high - 0.03 * span
        and (abs(values.mean() - 0.5 * (low + high)) < 0.055 * span)
    )


# ---------------------------------------------------------------- starts


@pytest.mark.parametrize(("pose_range", "scale"), [("full", 1.0), ("half", 0.5), ("quarter", 0.25)])
@pytest.mark.parametrize(("num_grippers", "first", "deviation"), [(2, 0.0, 20.0), (1, 45.0, 10.0)])
def test_poses_and_creases_fill_the_ranges_of_the_task_card(make_folding, pose_range, scale, num_grippers, first, deviation):
    base = make_folding(500, pose_range=pose_range, num_grippers=num_grippers, resolution=49).unwrapped
    centre, yaw, _ = frames_of_squares(base)
    assert fills(centre[:, 0], -0.15 * scale, 0.15 * scale)
    assert fills(centre[:, 1], -0.15 * scale, 0.15 * scale)
    assert fills(yaw, -math.pi * scale, math.pi * scale)
    angle, share = creases_of_squares(base)
    turns = (angle.rad2deg() - first) / 90.0
    deviations = 90.0 * (turns - turns.round())
    assert fills(deviations, -deviation * scale, deviation * scale)
    assert fills(share, 0.375 - 0.125 * scale, 0.375 + 0.125 * scale)
    # 500 draws of one of four sides: 125 +- 4 sigma
    assert all(86 < count < 164 for count in torch.bincount(turns.round().long() % 4, minlength=4).tolist())
    columns = torch.stack([centre[:, 0], centre[:, 1], yaw, deviations, share], dim=1).numpy()
    assert np.abs(np.corrcoef(columns.T) - np.eye(5)).max() < 0.2  # independent; 4.5 sigma
    card = ClothFoldingEnv.__doc__
    for text in ("[-0.15, 0.15] m", "[-180, 180] degrees", "[-20, 20] degrees", "[-10, 10] degrees", "[0.25, 0.5]"):
        assert text in card


@pytest.mark.parametrize("num_grippers", [1, 2])
def test_goals_are_mirror_images_one_thickness_above_the_resting_half(make_folding, num_grippers):
    base = make_folding(32, num_grippers=num_grippers).unwrapped
    start, goal, moving = base.solver.positions, base.goal_positions, base.is_moving > 0
    radius = base.solver.model.radius
    normal, crease = base.crease_normal, base.crease_ends.mean(dim=1)
    torch.testing.assert_close(normal.norm(dim=1), torch.ones(32))
    assert normal[:, 2].abs().max() == 0
    beyond = ((start - crease[:, None]) * normal[:, None]).sum(-1)
    assert torch.equal(moving, beyond > 0)
    lift = torch.tensor([0.0, 0.0, 2.0 * radius])
    image = start - 2.0 * beyond[..., None] * normal[:, None] + lift
    torch.testing.assert_close(goal[moving], image[moving], atol=1e-6, rtol=0)
    torch.testing.assert_close(goal[~moving], start[~moving], atol=1e-6, rtol=0)
    torch.testing.assert_close(start[..., 2], torch.full(start.shape[:2], radius))


def test_grippers_hold_the_extreme_points_of_the_moving_half(make_folding):
    for num_grippers in (1, 2):
        base = make_folding(64, num_grippers=num_grippers).unwrapped
        start, held = base.solver.positions, base.start_nodes
        beyond = (start * base.crease_normal[:, None]).sum(-1)
        corners = torch.as_tensor(base.models[0].node_sets["corners"])
        farthest = corners[beyond[:, corners].topk(num_grippers, dim=1).indices]
        assert torch.equal(held.sort(dim=1).values, farthest.sort(dim=1).values)
        assert (base.is_moving.gather(1, held) > 0).all()
        assert torch.equal(base.solver.gripper_positions, start.gather(1, held[..., None].expand(-1, -1, 3)))
        assert len(base.start_nodes.unique(dim=0)) == 4  # any side, any corner


@pytest.mark.parametrize("shape", ["rectangle", "triangle", "hexagon", "circle", "l_shape"])
def test_both_grippers_hold_different_moving_nodes_of_every_shape(make_folding, shape):
    base = make_folding(200, shapes=shape).unwrapped
    assert (base.start_nodes[:, 0] != base.start_nodes[:, 1]).all()
    assert (base.is_moving.gather(1, base.start_nodes) > 0).all()
    moving_mass = (base.is_moving * torch.as_tensor(base.models[0].masses)).sum(1) / base.models[0].masses.sum()
    # Nodes stand for the triangles around them: a row of nodes that is just beyond the crease or not.
    assert ((moving_mass > 0.25 - 0.12) & (moving_mass < 0.5 + 0.12)).all()


def test_no_start_is_solved_already(make_folding):
    for options in ({"num_grippers": 1, "resolution": 49}, {"shapes": ("triangle", "hexagon", "circle", "l_shape")}):
        env = make_folding(1000, **options)
        for seed in range(5):
            _, info = env.reset(seed=seed)
            assert (info["fold_distance"] > 2.0 * ClothFoldingEnv.FOLD_DISTANCE_LIMIT).all()


def test_a_cloth_that_is_left_alone_stays_flat(make_folding):
    env = make_folding(4)
    start = env.unwrapped.solver.positions.clone()
    for _ in range(10):
        *_, info = env.step(torch.zeros(4, 6))
    assert (env.unwrapped.solver.positions - start).norm(dim=-1).max() < 1e-4
    assert info["drift"].max() < 1e-4


# ---------------------------------------------------------------- success and reward


def test_success_is_a_small_mean_distance_of_each_half(make_folding):
    base = make_folding(6).unwrapped
    moving = base.is_moving > 0
    offsets = torch.zeros_like(base.goal_positions)
    offsets[0, moving[0], 2] = 0.0199
    offsets[1, moving[1], 2] = 0.0201
    offsets[2, ~moving[2], 0] = 0.0199
    offsets[3, ~moving[3], 0] = 0.0201
    offsets[4, moving[4].nonzero()[0], 1] = 0.1  # one node alone may be far
    base.solver.positions.copy_(base.goal_positions + offsets)
    base.solver.frozen[5] = True
    info = base.evaluate()
    assert info["success"].tolist() == [True, False, True, False, True, False]
    assert info["fail"].tolist() == [False] * 5 + [True]
    torch.testing.assert_close(info["fold_distance"][:4], torch.tensor([0.0199, 0.0201, 0.0, 0.0]), atol=1e-6, rtol=0)
    torch.testing.assert_close(info["drift"][:4], torch.tensor([0.0, 0.0, 0.0199, 0.0201]), atol=1e-6, rtol=0)


def test_reward_is_one_when_folded_bounded_and_falls_with_distance(make_folding):
    base = make_folding(16).unwrapped
    rewards = []
    for lift in torch.linspace(0.0, 0.2, 40):
        base.solver.positions.copy_(base.goal_positions)
        base.solver.positions[..., 2] += lift
        rewards.append(base.get_reward(None, None, base.get_info()))
    rewards = torch.stack(rewards)
    assert (rewards[0] == 1.0).all()
    assert (rewards.diff(dim=0) < 0).all()
    assert (rewards > 0).all()


def test_reward_is_the_formula_of_its_constants(make_folding):
    env = make_folding(8)
    generator = torch.Generator().manual_seed(0)
    for _ in range(4):
        _, reward, _, _, info = env.step(torch.randn(8, 6, generator=generator))
    base = env.unwrapped
    distances = (base.goal_positions - base.solver.positions).norm(dim=-1)
    fold = mean_over_nodes(distances, base.is_moving > 0)
    drift = mean_over_nodes(distances, base.is_moving == 0)
    total = fold + 1.5 * drift
    expected = 0.2 * (1 - torch.tanh(total / 0.1)) + 0.3 * torch.exp(-((total / 0.03) ** 2)) + 0.5 * info["success"]
    torch.testing.assert_close(reward, expected)


def test_pushing_the_whole_cloth_towards_the_goal_does_not_pay(make_folding):
    base = make_folding(64).unwrapped
    start = base.solver.positions.clone()
    rewards = []
    for shift in torch.linspace(0.0, 0.2, 21):
        base.solver.positions.copy_(start - shift * base.crease_normal[:, None])
        rewards.append(base.get_reward(None, None, base.get_info()))
    assert (torch.stack(rewards).diff(dim=0) < 0).all()


def test_reward_rises_along_the_fold(make_folding):
    """A moving half that turns about the crease like a board, which rises by its thickness on the way."""
    base = make_folding(16).unwrapped
    start, moving = base.solver.positions.clone(), (base.is_moving > 0)[..., None]
    normal, up = base.crease_normal[:, None], base.solver.plane[:, None, :3]
    beyond = ((start - base.crease_ends[:, :1]) * normal).sum(-1, keepdim=True)
    rewards = []
    for angle in torch.linspace(0.0, math.pi, 25):
        rise = base.solver.model.radius * (1.0 - angle.cos()) * up
        turned = start + beyond * ((angle.cos() - 1.0) * normal + angle.sin() * up) + rise
        base.solver.positions.copy_(torch.where(moving, turned, start))
        rewards.append(base.get_reward(None, None, base.get_info()))
    assert (torch.stack(rewards).diff(dim=0) > 0).all()


def test_success_of_folded_cloths_does_not_depend_on_the_frame(make_folding):
    base = make_folding(8).unwrapped
    heights = torch.linspace(0.0, 0.0385, 8)[:, None]
    base.solver.positions.copy_(base.goal_positions)
    base.solver.positions[..., 2] += heights * base.is_moving
    info = base.get_info()
    assert info["success"].tolist() == [True] * 4 + [False] * 4
    rotation = torch.as_tensor(Rotation.random(random_state=0).as_matrix(), dtype=torch.float32)
    base.move_worlds(rotation, torch.tensor([0.3, -0.4, 0.5]))
    moved = base.get_info()
    assert torch.equal(moved["success"], info["success"])
    for name in ("fold_distance", "drift"):
        torch.testing.assert_close(moved[name], info[name], atol=1e-6, rtol=0)
    torch.testing.assert_close(base.get_reward(None, None, moved), base.get_reward(None, None, info), atol=1e-5, rtol=0)


# ---------------------------------------------------------------- options


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_grippers": 4}, r"one of \[1, 2\], got 4: a fold has two extreme points"),
        ({"num_grippers": 0}, r"one of \[1, 2\], got 0"),
        ({"robot_uids": "floating_grippers_4"}, "robot_uids must be one of"),
        ({"num_grippers": 1, "shapes": "l_shape"}, "l_shape needs two grippers.*not convex"),
        ({"shapes": ("square", "star")}, "shapes of cloth must be among square"),
        ({"resolution": 48}, r"resolution must be in \[49, 1225\]"),
        ({"resolution": (100, 1226)}, r"resolution must be in \[49, 1225\]"),
        ({"pose_range": "third"}, "pose_range must be one of"),
        ({"material": {"colour": 1.0}}, "material"),
    ],
)
def test_bad_options_are_refused_with_the_reason(make_folding, options, message):
    with pytest.raises(ValueError, match=message):
        make_folding(1, **options)


@pytest.mark.parametrize(("num_grippers", "num_nodes"), [(None, 100), (2, 100), (1, 225)])
def test_one_gripper_gets_the_finer_cloth_by_default(make_folding, num_grippers, num_nodes):
    base = make_folding(1, num_grippers=num_grippers).unwrapped
    assert base.solver.num_nodes == num_nodes
    assert base.num_grippers == (num_grippers or 2)


def test_shapes_and_resolutions_mix_in_one_environment(make_folding):
    env = make_folding(64, shapes=("square", "triangle", "circle"), resolution=(49, 100), obs_mode="graph")
    base = env.unwrapped
    assert len(base.models) == 6
    assert len(base.solver.variants.unique()) == 6
    assert all(model.masses.sum() == pytest.approx(0.2 * 0.0576, rel=3e-2) for model in base.models)
    mask, moving = base.solver.node_mask, base.is_moving > 0
    assert not moving[~mask].any()
    assert (mask.gather(1, base.start_nodes)).all()
    before = base.evaluate()
    base.goal_positions[~mask] += 10.0  # padding counts nowhere
    after = base.evaluate()
    assert all(torch.equal(after[name], before[name]) for name in before)
    obs, *_ = env.step(torch.zeros(64, 6))
    base.graph_schema.validate(obs["graph"], values=True)


def test_graph_shows_the_crease_and_the_goals_of_what_is_held(make_folding):
    env = make_folding(4, obs_mode="graph", graph_nodes=20, graph_features="rich")
    base, (obs, _) = env.unwrapped, env.reset(seed=3)
    schema, graph = base.graph_schema, obs["graph"]
    names = [channel.name for channel in schema.actuator.vectors]
    vectors = dict(zip(names, graph["actuator"]["vectors"].unbind(2), strict=True))
    goals = base.goal_positions.gather(1, base.start_nodes[..., None].expand(-1, -1, 3))
    torch.testing.assert_close(vectors["goal_offset"], goals - base.solver.gripper_positions)
    assert torch.equal(vectors["crease_normal"], base.crease_normal[:, None].expand(-1, 2, -1))
    names = [channel.name for channel in schema.object.scalars]
    scalars = dict(zip(names, graph["object"]["scalars"].unbind(2), strict=True))
    assert scalars["held"].sum(dim=1).tolist() == [2.0] * 4
    assert ((scalars["is_moving"] == 0) | (scalars["is_moving"] == 1)).all()
    assert (scalars["is_moving"].mean(1) > 0.1).all()
    assert (scalars["is_moving"].mean(1) < 0.7).all()


def test_drawings_show_cloth_goal_and_crease(make_folding):
    base = make_folding(3, shapes=("square", "triangle")).unwrapped
    for world in range(3):
        drawing, model = base.drawing(world), base.models[int(base.solver.variants[world])]
        assert drawing.object.vertices.shape == (model.num_nodes, 3)
        assert 0 < len(drawing.goal.faces) < len(model.faces)
        # What is shown of the goal ends at the crease.
        beyond = (drawing.goal.vertices - base.crease_ends[world, 0].numpy()) @ base.crease_normal[world].numpy()
        assert beyond[drawing.goal.faces].max() < 1e-6
        # The goal lies upside down: its faces, counter-clockwise as seen from the front, look up when turned over.
        corners = drawing.goal.vertices[drawing.goal.faces]
        assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > -1e-9).all()
        (line,) = drawing.lines
        np.testing.assert_allclose((line.points[1] - line.points[0]) @ base.crease_normal[world].numpy(), 0.0, atol=1e-6)
        assert not drawing.is_solved
        assert drawing.has_table
