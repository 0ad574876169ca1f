"""ClothHanging-v1 keeps what its task card promises."""

import gc
import math

import gymnasium as gym
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.tasks import CLOTH_SHAPES, ClothHangingEnv
from maniskill_grpd.tasks.geometry.bar_hanger import BarHanger
from maniskill_grpd.tasks.geometry.peg_hanger import PegHanger


@pytest.fixture
def make_env(monkeypatch):
    """Return a function that makes ClothHanging-v1 on the CPU, reset with seed 0."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    made = []

    def make(num_envs=3, **options):
        made.append(gym.make("ClothHanging-v1", num_envs=num_envs, sim_backend="cpu", render_backend="none", **options))
        made[-1].reset(seed=0)
        return made[-1]

    yield make
    for env in made:
        env.close()


def still(env):
    return torch.zeros(env.action_space.shape)


# ---------------------------------------------------------------- starts


def cloth_frames(base):
    """Return the middles (B, 3) and rotations (B, 3, 3) of square cloths that lie flat, from their corners."""
    corners = base.solver.positions.gather(1, base.start_nodes[..., None].expand(-1, -1, 3))
    x = torch.nn.functional.normalize(corners[:, 1] - corners[:, 0], dim=-1)
    y = torch.nn.functional.normalize(corners[:, 3] - corners[:, 0], dim=-1)
    return corners.mean(dim=1), torch.stack([x, y, torch.linalg.cross(x, y)], dim=-1)


def fills(values, low, high):
    """Tell whether 1000 values lie in an interval and come within a hundredth of both of its ends."""
    margin = 0.01 * (high - low)
    return low - 1e-4 <= values.min() <= low + margin and high - margin <= values.max() <= high + 1e-4


@pytest.mark.parametrize(("pose_range", "share"), [("full", 1.0), ("half", 0.5), ("quarter", 0.25)])
def test_poses_fill_the_ranges_of_the_task_card(make_env, pose_range, share):
    env = make_env(1000, pose_range=pose_range)
    base = env.unwrapped
    middle, rotation = cloth_frames(base)
    assert all(fills(middle[:, k], -0.1 * share, 0.1 * share) for k in range(3))
    lowest = math.cos(share * math.pi)
    hanger = base.hanger_point - 0.125 * base.hanger_axis
    distance = hanger.norm(dim=-1)
    assert fills(distance, 0.75, 0.85)
    cosines = [rotation[:, 2, 2], hanger[:, 0] / distance, base.hanger_axis[:, 2]]  # normal, direction of the peg, its axis
    for cosine in cosines:
        assert fills(cosine, lowest, 1.0)
        # Uniform on a cap: cosines are uniform. Their mean deviates by 4 sigma at most.
        assert abs(cosine.mean() - (1 + lowest) / 2) < 4 * (1 - lowest) / math.sqrt(12 * 1000)
    columns = np.column_stack([*(middle[:, k] for k in range(3)), *cosines, distance])
    assert np.abs(np.corrcoef(columns.T) - np.eye(7)).max() < 0.14  # independent; 4.5 sigma


def test_a_peg_to_let_go_on_points_upwards(make_env):
    axis = make_env(1000, release=True).unwrapped.hanger_axis
    assert fills(axis[:, 2], math.cos(math.radians(45)), 1.0)
    assert "within 45 degrees" in ClothHangingEnv.__doc__


def test_bars_fill_the_ranges_of_the_task_card(make_env):
    base = make_env(1000, hanger="bar").unwrapped
    axis = base.hanger_axis
    assert fills(base.hanger_point.norm(dim=-1), 0.85, 0.95)
    assert fills(torch.rad2deg(torch.asin(axis[:, 2])), -15.0, 15.0)
    assert fills(torch.rad2deg(torch.atan2(-axis[:, 0], axis[:, 1])), -90.0, 90.0)


@pytest.mark.parametrize("hanger", ["peg", "bar"])
def test_no_cloth_starts_near_its_hanger_whatever_the_options(make_env, hanger):
    """By construction: the largest cloth, the largest hole and so the widest plate."""
    options = {"hole_radius": 0.1} if hanger == "peg" else {}
    base = make_env(1000, shapes=("square", "triangle", "circle"), num_grippers=3, hanger=hanger, **options).unwrapped
    middle, reach = base.hanger_point.clone(), 0.3
    if hanger == "peg":
        middle -= 0.125 * base.hanger_axis
        reach = math.hypot(0.125 + 0.02, 0.17)
    gaps = (base.solver.positions - middle[:, None]).norm(dim=-1).masked_fill(~base.solver.node_mask, torch.inf)
    assert gaps.min() > reach + base.solver.model.radius
    assert not base.evaluate()["success"].any()


# ---------------------------------------------------------------- success


def lay_on_peg(base, depth, angle=0.0, aside=0.0):
    """Put flat cloths beside or on their pegs: how deep their middle is [m], how tilted [deg], how far off the axis [m]."""
    solver, num = base.solver, base.num_envs
    depth, angle, aside = (np.broadcast_to(np.asarray(value, float), num) for value in (depth, angle, aside))
    frames = Rotation.random(num, random_state=1).as_matrix()  # columns: aside, across, axis
    tilt = Rotation.from_rotvec(np.deg2rad(angle)[:, None] * np.array([0.0, 1.0, 0.0])).as_matrix()
    base.hanger_axis.copy_(torch.as_tensor(frames[..., 2]))
    flat = base.rest_positions[solver.variants.long()].numpy()
    offset = np.stack([aside, 0 * aside, -depth], axis=-1)
    points = (flat @ tilt.swapaxes(1, 2) + offset[:, None]) @ frames.swapaxes(1, 2)
    solver.positions.copy_(torch.as_tensor(points) + base.hanger_point[:, None])


def start_from_here(base):
    """Let the pegs stand where the axes say, and the grippers hold the cloths where they are, at rest."""
    solver, worlds = base.solver, torch.arange(base.num_envs)
    turns = [Rotation.align_vectors(axis[None], [[0.0, 0.0, 1.0]])[0].as_quat() for axis in base.hanger_axis.numpy()]
    solver.collider_rotations.copy_(torch.as_tensor(np.array(turns)[:, None, [3, 0, 1, 2]]))
    for index, distance in enumerate((0.125, 0.26)):
        solver.collider_positions[:, index] = base.hanger_point - distance * base.hanger_axis
    solver.reset(worlds, solver.positions.clone(), base.start_nodes)
    base.agent.robot.place(worlds)


# Depth [m], tilt [degrees], distance from the axis [m] -> threaded, hung.
PEG_CASES = {
    "deep, square on": (0.10, 0, 0.0, True, True),
    "upside down": (0.10, 180, 0.0, True, True),
    "just deep enough": (0.081, 0, 0.0, True, True),
    "not deep enough": (0.079, 0, 0.0, True, False),
    "tilted by less than 35 degrees": (0.12, 34, 0.0, True, True),
    "tilted by more": (0.12, 36, 0.0, True, False),
    "the axis inside the rim": (0.10, 0, 0.05, True, True),
    "the axis through the cloth": (0.10, 0, 0.08, False, False),
    "beside the peg": (0.10, 0, 0.5, False, False),
    "before the tip": (-0.05, 0, 0.0, False, False),
    "at the plate": (0.249, 0, 0.0, True, True),
    "behind the plate": (0.30, 0, 0.0, False, False),
}


def test_hung_on_a_peg_means_threaded_deep_and_square_on(make_env):
    base = make_env(len(PEG_CASES)).unwrapped
    depth, angle, aside, threaded, hung = (np.array(column) for column in zip(*PEG_CASES.values(), strict=True))
    lay_on_peg(base, depth, angle, aside)
    info = base.evaluate()
    assert dict(zip(PEG_CASES, info["is_threaded"].tolist(), strict=True)) == dict(zip(PEG_CASES, threaded, strict=True))
    assert dict(zip(PEG_CASES, info["success"].tolist(), strict=True)) == dict(zip(PEG_CASES, hung, strict=True))
    np.testing.assert_allclose(info["hole_depth"], depth, atol=1e-5)
    np.testing.assert_allclose(info["hole_angle"], np.deg2rad(np.minimum(angle, 180 - angle)), atol=1e-3)


HALF_EDGE = 0.5 * 0.4 / 9
"""Half the distance between two rows of nodes [m]: what spans the bar."""


def lay_on_bar(base, fold, *, height=0.0, flat=False):
    """Bend cloths over their bars along a line at x = fold (B,) of the rest shape, so high above the axis; or leave them flat."""
    solver, axis = base.solver, base.hanger_axis
    up = torch.tensor([[0.0, 0.0, 1.0]]) - axis[:, 2:] * axis
    up = torch.nn.functional.normalize(up, dim=-1)
    side = torch.linalg.cross(axis, up)
    x, y, _ = base.rest_positions[solver.variants.long()].unbind(-1)
    x = x - torch.as_tensor(fold, dtype=torch.float32).expand(base.num_envs)[:, None]
    bend = 0.0 if flat else 0.013 - 0.8 * (x.abs() - HALF_EDGE).clamp(min=0.0)
    high = torch.as_tensor(height, dtype=torch.float32).expand(base.num_envs)[:, None] + bend
    across = x if flat else 0.6 * x
    points = across[..., None] * side[:, None] + high[..., None] * up[:, None] + y[..., None] * axis[:, None]
    solver.positions.copy_(points + base.hanger_point[:, None])


def test_hung_on_a_bar_means_that_both_halves_hang_from_above_it(make_env):
    base = make_env(5, hanger="bar").unwrapped
    lay_on_bar(base, [0.0, 0.03, 0.15, -0.15, 0.0], height=[0.0, 0.0, 0.0, 0.0, 0.1])
    info = base.evaluate()
    assert info["success"].tolist() == [True, True, False, False, False]  # off the middle, and well above the bar
    assert info["lies_on_bar"].tolist() == [True, True, False, False, False]


@pytest.mark.parametrize("height", [0.02, -0.02, -0.045, -0.2])
def test_a_flat_cloth_is_not_draped(make_env, height):
    """Below the bar all of it hangs lower than the bar, half on either side."""
    base = make_env(3, hanger="bar").unwrapped
    lay_on_bar(base, 0.0, height=height, flat=True)
    assert not base.evaluate()["success"].any()


def test_a_cloth_bent_upwards_below_a_bar_is_not_draped(make_env):
    base = make_env(3, hanger="bar").unwrapped
    lay_on_bar(base, 0.0, height=-0.03)
    assert not base.evaluate()["success"].any()


def test_with_release_success_needs_one_second_with_open_grippers(make_env):
    """Once hung and let go on a steep peg, a cloth slides onto the plate and stays."""
    env = make_env(2, release=True)
    base = env.unwrapped
    lay_on_peg(base, 0.12)
    start_from_here(base)
    base.solver.gravity.copy_(-9.81 * base.hanger_axis)
    closed, opened = still(env), still(env)
    closed[:, 3::4], opened[:, 3::4] = 1.0, -1.0
    partly = closed.clone()
    partly[:, 3] = -1.0
    assert base.evaluate()["is_hung"].all()
    assert not any(env.step(closed)[4]["success"].any() for _ in range(3))
    rewards = torch.stack([env.step(action)[1] for action in (closed, partly, opened)])
    assert (rewards.diff(dim=0) > 0.01).all()  # opening pays
    successes = torch.stack([env.step(opened)[4]["success"] for _ in range(20)])
    assert successes.all(dim=1).tolist() == successes.any(dim=1).tolist() == [False] * 18 + [True] * 2  # open once before
    assert base.evaluate()["is_hung"].all()
    assert not env.step(partly)[4]["success"].any()


def test_the_time_with_open_grippers_is_part_of_the_state(make_env):
    env = make_env(2, release=True)
    base = env.unwrapped
    opened = still(env)
    for _ in range(5):
        env.step(opened)
    saved = base.get_state_dict()
    assert saved["episode"]["open_steps"].flatten().tolist() == [5.0, 5.0]
    env.reset(seed=1)
    assert base.get_state_dict()["episode"]["open_steps"].flatten().tolist() == [0.0, 0.0]
    base.set_state_dict(saved)
    assert base.get_state_dict()["episode"]["open_steps"].flatten().tolist() == [5.0, 5.0]


# ---------------------------------------------------------------- reward


def reward_of(base):
    return base.get_reward(None, None, base.get_info())


def test_reward_rises_all_the_way_onto_the_peg(make_env):
    """From afar to the front, through the funnel, onto the tip and down; waiting pays less than half of hanging."""
    aside = [0.5, 0.3, 0.15, 0.06, 0.03, 0.0, 0.0, 0.0, 0.0]
    depth = [-0.08, -0.08, -0.08, -0.08, -0.05, -0.02, 0.02, 0.05, 0.1]
    base = make_env(len(aside)).unwrapped
    lay_on_peg(base, depth, 0.0, aside)
    reward = reward_of(base)
    assert (reward.diff() > -1e-6).all()
    assert reward[-1] == pytest.approx(1.0, abs=1e-5)
    assert reward[5] < 0.5
    lay_on_peg(base, depth, 30.0, aside)
    assert (reward_of(base) < reward).all()  # turning pays


def test_every_centimetre_of_the_last_ones_before_the_tip_pays(make_env):
    """On the axis, from 12 cm before the tip through it: no plateau on which a policy could wait, and no step back."""
    base = make_env(14).unwrapped
    lay_on_peg(base, np.linspace(-0.12, 0.01, 14), 0.0, 0.0)
    gain = reward_of(base).diff()
    assert (gain[:3] > 0.003).all()  # by the way alone
    assert (gain[4:11] > 0.02).all()
    assert (gain > 0.0).all()


def test_a_slack_cloth_earns_less_until_it_is_on_the_hanger(make_env):
    """Grippers that bunch: full pay from 70 % of the area on, in proportion below, and no pulling on the peg."""
    sizes = torch.tensor([0.3, 0.6, 0.85, 1.0])
    base = make_env(len(sizes)).unwrapped
    for depth, expected in ((-0.3, (sizes.square() / base.FULL_SPREAD).clamp(max=1.0)), (0.05, torch.ones(4))):
        lay_on_peg(base, depth, 0.0, 0.0)
        middle = base.seat_loop()[:, :-1].mean(dim=1, keepdim=True)
        base.solver.positions.copy_(middle + sizes[:, None, None] * (base.solver.positions - middle))
        base.forget_measurement()
        torch.testing.assert_close(base._spread(base.measurement.hanging), expected, atol=2e-3, rtol=0)


def test_coming_from_beside_the_peg_the_way_leads_round_the_tip(make_env):
    """Beside the peg nearer to it is no better, but nearer to its front is."""
    base = make_env(3).unwrapped
    lay_on_peg(base, [0.1, 0.1, 0.0], 0.0, [0.15, 0.3, 0.3])
    base.evaluate()
    way = base.measurement.hanging.way
    assert way[0] > 0.2
    assert way[2] < way[1]


def test_reward_rises_over_the_bar(make_env):
    base = make_env(3, hanger="bar").unwrapped
    rewards = []
    for fold, height, flat in ((0.0, 0.3, True), (0.0, 0.05, True), (0.0, 0.0, False)):
        lay_on_bar(base, fold, height=height, flat=flat)
        rewards.append(reward_of(base))
    assert (rewards[0] < rewards[1]).all()
    assert (rewards[1] < 0.5).all()
    assert (rewards[2] > 0.95).all()


def test_weights_of_the_reward_sum_to_one():
    weights = ("WAY_WEIGHT", "SPREAD_WEIGHT", "ALIGNMENT_WEIGHT", "PROGRESS_WEIGHT", "SUCCESS_WEIGHT")
    assert sum(getattr(ClothHangingEnv, name) for name in weights) == pytest.approx(1.0)


@pytest.mark.parametrize("options", [{"hanger": "bar"}, {"release": True}, {"shapes": "l_shape"}])
def test_other_configurations_do_not_depend_on_the_frame_either(make_env, options):
    """Near and on the hanger, where all terms of the reward and all conditions count."""
    base = make_env(8, **options).unwrapped
    if "hanger" in options:
        lay_on_bar(base, np.linspace(-0.1, 0.1, 8), height=np.linspace(-0.02, 0.02, 8))
    else:
        base.rest_positions -= base.rest_positions[0, base.models[0].node_sets["hole_0"]].mean(dim=0)
        lay_on_peg(base, np.linspace(-0.1, 0.2, 8), np.linspace(0, 40, 8), np.linspace(0, 0.05, 8))
    reward, info = reward_of(base), base.evaluate()
    assert 0 < info["is_hung"].sum() < 8
    rotation = torch.as_tensor(Rotation.random(random_state=3).as_matrix(), dtype=torch.float32)
    base.move_worlds(rotation, torch.tensor([0.3, -0.2, 0.5]))
    torch.testing.assert_close(reward_of(base), reward, atol=1e-4, rtol=0)
    assert torch.equal(base.evaluate()["is_hung"], info["is_hung"])


# ---------------------------------------------------------------- observation


def test_channels_say_where_hanger_and_hole_are(make_env):
    env = make_env(4, graph_features="rich")
    base = env.unwrapped
    lay_on_peg(base, 0.1, 20.0, 0.01)
    graph, schema, solver = base.get_obs()["graph"], base.graph_schema, base.solver

    def channel(kind, name):
        nodes = getattr(schema, "object" if kind == "object" else "actuator")
        for group in ("vectors", "scalars"):
            names = [entry.name for entry in getattr(nodes, group)]
            if name in names:
                return graph[kind][group][:, :, names.index(name)]
        raise KeyError(name)

    torch.testing.assert_close(channel("object", "hanger_offset"), base.hanger_point[:, None] - solver.positions)
    torch.testing.assert_close(channel("object", "hanger_axis")[:, 5], base.hanger_axis)
    in_seat = torch.zeros(4, solver.num_nodes)
    in_seat[:, base.models[0].node_sets["hole_0"]] = 1.0
    torch.testing.assert_close(channel("object", "seat"), in_seat)
    rim = solver.positions[:, base.models[0].node_sets["hole_0"]]
    offset = base.hanger_point - rim.mean(dim=1)
    torch.testing.assert_close(channel("actuator", "seat_offset"), offset[:, None].expand(-1, 4, -1), atol=1e-3, rtol=0)
    torch.testing.assert_close(channel("actuator", "seat_depth"), torch.full((4, 4), 0.1), atol=1e-5, rtol=0)
    cosine = (channel("actuator", "seat_normal")[:, 0] * base.hanger_axis).sum(-1)
    torch.testing.assert_close(cosine, torch.full((4,), math.cos(math.radians(20))), atol=1e-4, rtol=0)
    # The nearest point of the peg's axis, from grippers 20 cm and more beside it.
    relative = solver.gripper_positions - base.hanger_point[:, None]
    along = (relative * base.hanger_axis[:, None]).sum(-1, keepdim=True).clamp(PegHanger.RADIUS - 0.25, -PegHanger.RADIUS)
    gap = (relative - along * base.hanger_axis[:, None]).norm(dim=-1) - PegHanger.RADIUS
    torch.testing.assert_close(channel("actuator", "hanger_distance"), gap, atol=1e-5, rtol=0)


def test_bars_are_seen_from_their_nearest_point(make_env):
    base = make_env(4, hanger="bar").unwrapped
    base.get_info()
    offset = base.gripper_values(base.measurement)["hanger_offset"]
    target = base.solver.gripper_positions + offset - base.hanger_point[:, None]
    along = (target * base.hanger_axis[:, None]).sum(-1, keepdim=True)
    torch.testing.assert_close(target, along * base.hanger_axis[:, None], atol=1e-5, rtol=0)
    assert along.abs().max() <= BarHanger.LENGTH / 2 + 1e-6


# ---------------------------------------------------------------- options


def test_shapes_and_resolutions_mix_across_worlds(make_env):
    env = make_env(200, shapes=tuple(CLOTH_SHAPES), resolution=(60, 100), num_grippers=3)
    base = env.unwrapped
    counts = torch.bincount(base.solver.variants, minlength=12)
    assert len(base.models) == 12
    assert (counts > 3).all()  # 200 draws of one in twelve: 16.7, less than 4 in one of 10,000 runs
    for world in range(0, 200, 20):
        model = base.models[int(base.solver.variants[world])]
        assert base.solver.node_mask[world].sum() == model.num_nodes
        assert set(base.start_nodes[world].tolist()) <= set(model.node_sets["corners"].tolist())
    obs, reward, *_ = env.step(env.action_space.sample())
    base.graph_schema.validate(obs["graph"], values=True)
    assert torch.isfinite(reward).all()


@pytest.mark.parametrize("name", CLOTH_SHAPES)
def test_a_cloth_of_every_shape_hangs_on_the_peg_by_its_hole(make_env, name):
    base = make_env(2, shapes=name, num_grippers=3).unwrapped
    hole = base.rest_positions[0, base.models[0].node_sets["hole_0"]].mean(dim=0)
    base.rest_positions -= hole
    lay_on_peg(base, 0.1, 10.0)
    assert base.evaluate()["success"].all()


def test_holes_have_the_radius_asked_for(make_env):
    model = make_env(1, hole_radius=0.09).unwrapped.models[0]
    rim = model.rest_positions[model.node_sets["hole_0"]]
    np.testing.assert_allclose(np.linalg.norm(rim, axis=1), 0.09, atol=1e-3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hanger": "hook"}, r"hanger must be one of \['peg', 'bar'\], got 'hook'"),
        ({"hanger": "bar", "hole_radius": 0.06}, "draped over a bar has no hole"),
        ({"hole_radius": 0.5}, r"hole_radius must be in \[0.03, 0.1\] m"),
        ({"hole_radius": 0.01}, "so that a peg passes"),
        ({"shapes": "star"}, "must be among square"),
        ({"shapes": "triangle"}, "one with 3 corners cannot take num_grippers=4"),
        ({"num_grippers": 2}, "two hands cannot turn a cloth about the line between them"),
        ({"num_grippers": 5}, r"num_grippers must be one of \[3, 4\]"),
        ({"resolution": 20}, r"resolution must be in \[49, 1225\]"),
        ({"resolution": (100, 5000)}, r"resolution must be in \[49, 1225\]"),
        ({"release": True, "grasp": "fixed"}, "release=True needs grippers that open"),
        ({"release": True, "control_mode": "pd_ee_delta_pos"}, "release=True needs grippers that open"),
    ],
)
def test_options_that_cannot_be_met_are_refused_with_the_reason(options, message):
    with pytest.raises(ValueError, match=message):
        gym.make("ClothHanging-v1", sim_backend="cpu", render_backend="none", **options)


# ---------------------------------------------------------------- contact


def pierces(points, faces, start, end):
    """Tell in which worlds the segment start ... end, each (B, 3), crosses a triangle of the cloth, (B,) bool."""
    a, b, c = (points[:, faces[:, k]].double() for k in range(3))
    direction = (end - start).double()[:, None].expand_as(a)
    first, second, offset = b - a, c - a, start.double()[:, None] - a
    normal = torch.linalg.cross(direction, second)
    determinant = (first * normal).sum(-1)
    across = torch.linalg.cross(offset, first)
    u, v, t = ((p * q).sum(-1) / determinant for p, q in ((offset, normal), (direction, across), (second, across)))
    return ((u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0) & (t <= 1)).any(dim=1)


def test_a_peg_does_not_pierce_the_cloth_at_full_speed(make_env):
    """Pushed onto the tip beside the hole until the cloth is stretched as far as its weave lets it."""
    env = make_env(64)
    base, solver = env.unwrapped, env.unwrapped.solver
    spots = Rotation.random(64, random_state=0).as_matrix()[:, 0, :2]
    aside = 0.09 + 0.08 * np.linalg.norm(spots, axis=1)
    lay_on_peg(base, -0.05, 0.0, aside)
    start_from_here(base)
    down = (-base.hanger_axis)[:, None].expand(-1, 4, -1).flatten(1)
    # Triangles that lie on the round end may dip below its very tip.
    top = base.hanger_point - (PegHanger.RADIUS + solver.model.radius) * base.hanger_axis
    foot = base.hanger_point - PegHanger.LENGTH * base.hanger_axis
    for _ in range(3):
        env.step(down)
        assert not pierces(solver.positions, base.models[0].faces, top, foot).any()
    relative = solver.positions - base.hanger_point[:, None]
    depth = -(relative * base.hanger_axis[:, None]).sum(-1)
    assert (depth.amin(dim=1) < 0.0).all()  # the tip holds it back
    assert (depth.amax(dim=1) > 0.03).all()


# ---------------------------------------------------------------- pictures


@pytest.mark.parametrize(("options", "num_solids"), [({}, 2), ({"hanger": "bar"}, 1)])
def test_drawings_show_the_cloth_of_the_world_and_its_hanger(make_env, options, num_solids):
    base = make_env(8, shapes=("square", "circle"), **options).unwrapped
    for world in range(8):
        model, drawing = base.models[int(base.solver.variants[world])], base.drawing(world)
        np.testing.assert_array_equal(drawing.object.vertices, base.solver.positions[world, : model.num_nodes])
        np.testing.assert_array_equal(drawing.object.faces, model.faces)
        assert not drawing.has_table
        assert len(drawing.solids) == num_solids
        pose = base.hanger_point[[world]], base.hanger_axis[[world]]
        distance = base._hanger.distances_to(torch.as_tensor(drawing.solids[0].vertices[None], dtype=torch.float32), *pose)
        assert distance.abs().max() < 1e-4  # what is drawn is what is touched
