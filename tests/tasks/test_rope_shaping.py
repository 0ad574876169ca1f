"""RopeShaping-v1 keeps what its task card promises."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from maniskill_grpd.tasks import RopeShapingEnv, goal_curve


def centres_and_yaws(curves):
    """Return centres (b, 2) and directions from first to last node (b,) of curves (b, N, 3)."""
    chord = (curves[:, -1] - curves[:, 0])[:, :2]
    return curves.mean(dim=1)[:, :2], torch.atan2(chord[:, 1], chord[:, 0])


@pytest.mark.parametrize(("pose_range", "share"), [("full", 1.0), ("half", 0.5), ("quarter", 0.25)])
def test_poses_fill_the_ranges_of_the_task_card(make_env, pose_range, share):
    env = make_env(500, pose_range=pose_range)
    env.reset(seed=0)
    base = env.unwrapped
    start, goal = base.solver.positions, base.goal_positions
    poses = [centres_and_yaws(start), centres_and_yaws(goal)]
    for centre, yaw in poses:
        for coordinate, bound in [(centre[:, 0], 0.15), (centre[:, 1], 0.15), (yaw, math.pi)]:
            bound *= share
            assert coordinate.abs().max() <= bound * (1 + 1e-5)
            assert coordinate.max() > 0.97 * bound
            assert coordinate.min() < -0.97 * bound
            # 500 uniform draws: the mean deviates by 4 sigma = 4 bound / sqrt(3 * 500) at most
            assert abs(coordinate.mean()) < 0.11 * bound
    columns = np.column_stack([part.numpy().reshape(500, -1) for pose in poses for part in pose])
    correlation = np.corrcoef(columns.T) - np.eye(6)
    assert np.abs(correlation).max() < 0.2  # independent; 4.5 sigma
    assert "[-0.15, 0.15] m" in RopeShapingEnv.__doc__
    assert "[-180, 180] degrees" in RopeShapingEnv.__doc__


def test_start_is_a_straight_rope_on_the_table_and_the_goal_lies_on_it(make_env):
    env = make_env(8, resolution=50)
    env.reset(seed=1)
    base = env.unwrapped
    start, goal = base.solver.positions, base.goal_positions
    torch.testing.assert_close(start[..., 2], torch.full((8, 50), base.solver.model.radius))
    torch.testing.assert_close(goal[..., 2], torch.full((8, 50), base.solver.model.radius))
    assert base.solver.model.length == pytest.approx(0.8)
    torch.testing.assert_close((start[:, -1] - start[:, 0]).norm(dim=-1), torch.full((8,), 0.8))
    for curve in (start, goal):
        segments = curve.diff(dim=1).norm(dim=-1)
        torch.testing.assert_close(segments, torch.full((8, 49), 0.8 / 49), atol=1e-5, rtol=0)


def test_resting_rope_stays_where_it_is(make_env):
    env = make_env(2)
    env.reset(seed=0)
    start = env.unwrapped.solver.positions.clone()
    for _ in range(10):
        env.step(torch.zeros(2, 12))
    assert (env.unwrapped.solver.positions - start).norm(dim=-1).max() < 1e-3


@pytest.mark.parametrize(
    ("num_grippers", "nodes"), [(2, [0, 40]), (3, [0, 20, 40]), (4, [0, 10, 30, 40]), (None, [0, 10, 30, 40])]
)
def test_grippers_hold_the_rope_at_their_arc_fractions(make_env, num_grippers, nodes):
    env = make_env(2, num_grippers=num_grippers)
    base = env.unwrapped
    assert base.agent.uid == f"floating_grippers_{len(nodes)}"
    held = [(base.solver.holder[0] == gripper).nonzero()[:, 0].tolist() for gripper in range(len(nodes))]
    assert held == [[node] for node in nodes]
    assert torch.equal(base.solver.gripper_positions, base.solver.positions[:, nodes])
    assert env.action_space.shape == (2, 3 * len(nodes))


def test_robot_uids_choose_the_number_of_grippers(make_env):
    assert make_env(1, robot_uids="floating_grippers_2").unwrapped.num_grippers == 2


def test_each_episode_draws_one_of_several_shapes(make_env):
    names = ("W", "S", "spiral")
    env = make_env(200, shapes=names)
    env.reset(seed=0)
    ends = [np.linalg.norm(np.subtract(*goal_curve(name, 0.8, 41)[[0, -1]])) for name in names]
    goal = env.unwrapped.goal_positions
    distance = (goal[:, 0] - goal[:, -1]).norm(dim=-1, keepdim=True)
    drawn = (distance - torch.tensor(ends)).abs().argmin(dim=1)
    # 200 draws of one in three: 67 +- 4 sigma
    assert all(40 < count < 94 for count in torch.bincount(drawn, minlength=3).tolist())


def test_success_needs_a_small_mean_and_no_far_node(make_env):
    env = make_env(4)
    base = env.unwrapped
    offsets = torch.zeros(4, 41, 3)
    offsets[0, :, 2] = 0.0299  # mean just inside
    offsets[1, :, 2] = 0.0301  # mean outside
    offsets[2, 5, 0] = 0.0799  # one node far, just inside
    offsets[3, 5, 0] = 0.0801  # one node too far
    base.solver.positions.copy_(base.goal_positions + offsets)
    info = base.evaluate()
    assert set(info) == {"success", "fail", "mean_distance", "max_distance"}
    assert info["success"].tolist() == [True, False, True, False]
    torch.testing.assert_close(info["max_distance"][2:], torch.tensor([0.0799, 0.0801]), atol=1e-6, rtol=0)
    torch.testing.assert_close(info["mean_distance"], offsets.norm(dim=-1).mean(dim=1), atol=1e-6, rtol=0)


def test_reward_is_one_at_the_goal_bounded_and_falls_with_distance(make_env):
    env = make_env(64)
    base = env.unwrapped
    shifts = torch.linspace(0, 1.5, 64)
    base.solver.positions.copy_(base.goal_positions)
    base.solver.positions[..., 0] += shifts[:, None]
    reward = base.get_reward(None, None, base.get_info())
    assert reward[0] == 1.0
    assert (reward.diff() < 0).all()
    assert (reward > 0).all()
    assert (reward <= 1).all()


def test_reward_is_the_formula_of_its_constants(make_env, draw_actions):
    env = make_env()
    for action in draw_actions(3, 3):
        _, reward, _, _, info = env.step(action)
    base = env.unwrapped
    d = (base.goal_positions - base.solver.positions).norm(dim=-1)
    expected = (
        base.FAR_WEIGHT * (1 - torch.tanh(d.mean(dim=1) / base.FAR_SCALE))
        + base.NEAR_WEIGHT * torch.exp(-((d.mean(dim=1) / base.NEAR_SCALE) ** 2))
        + base.SUCCESS_WEIGHT * info["success"]
    )
    torch.testing.assert_close(reward, expected)
    weights = [base.FAR_WEIGHT, base.NEAR_WEIGHT, base.SUCCESS_WEIGHT]
    assert sum(weights) == pytest.approx(1.0)
    torch.testing.assert_close(base.compute_dense_reward(None, None, info), reward)


@pytest.fixture
def near_goal_env(make_env, draw_actions):
    """Worlds in motion; in half of them the goal is near: the reward has all its terms."""
    env = make_env(4, shapes=("W", "S"))
    for action in draw_actions(3, 4):
        env.step(action)
    base = env.unwrapped
    base.goal_positions[:2] = base.solver.positions[:2] + 0.005
    return env


def test_rewards_success_and_graph_do_not_depend_on_the_frame(near_goal_env):
    base = near_goal_env.unwrapped
    state = base.get_state_dict()
    graph, info = base.get_obs()["graph"], base.get_info()
    reward = base.get_reward(None, None, info)
    assert info["success"].tolist() == [True, True, False, False]

    @given(st.integers(0, 10_000))
    @hypothesis_settings(max_examples=15)
    def check(seed):
        base.set_state_dict(state)
        rotation = torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)
        translation = torch.randn(3, generator=torch.Generator().manual_seed(seed))
        base.move_worlds(rotation, translation)
        moved, moved_info = base.get_obs()["graph"], base.get_info()
        torch.testing.assert_close(base.get_reward(None, None, moved_info), reward, atol=1e-5, rtol=0)
        assert torch.equal(moved_info["success"], info["success"])
        for kind in ("object", "actuator"):
            there, here = moved[kind], graph[kind]
            torch.testing.assert_close(there["scalars"], here["scalars"], atol=2e-6, rtol=0)
            torch.testing.assert_close(there["vectors"], here["vectors"] @ rotation.T, atol=5e-6, rtol=0)
            torch.testing.assert_close(there["position"], here["position"] @ rotation.T + translation, atol=2e-6, rtol=0)
        torch.testing.assert_close(moved["gravity"], graph["gravity"] @ rotation.T, atol=1e-5, rtol=0)

    check()


@pytest.mark.parametrize("axis", range(3))
def test_success_is_the_same_in_every_frame_up_to_its_limits(make_env, axis):
    """Distances that are measured along an axis of the world would be right in some frames only."""
    base = make_env(4).unwrapped
    base.goal_positions.copy_(base.solver.positions)
    base.goal_positions[0, :, axis] += 0.0295
    base.goal_positions[1, :, axis] += 0.0305
    base.goal_positions[2, 7, axis] += 0.0795
    base.goal_positions[3, 7, axis] += 0.0805
    state = base.get_state_dict()
    for seed in range(10):
        base.set_state_dict(state)
        rotation = torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)
        base.move_worlds(rotation, torch.tensor([0.2, -0.1, 0.3]))
        assert base.evaluate()["success"].tolist() == [True, False, True, False]


def test_moving_the_goal_alone_changes_the_reward(near_goal_env):
    """Negative control of the test above."""
    base = near_goal_env.unwrapped
    reward = base.get_reward(None, None, base.get_info())
    base.goal_positions += 0.5
    change = base.get_reward(None, None, base.get_info()) - reward
    assert (change[:2] < -0.5).all()  # these were at their goals
    assert (change[2:] != 0).all()  # far from goals rewards differ little


def test_a_step_commutes_with_moving_everything(near_goal_env, draw_actions):
    env, base = near_goal_env, near_goal_env.unwrapped
    rotation = torch.as_tensor(Rotation.random(random_state=0).as_matrix(), dtype=torch.float32)
    translation = torch.tensor([0.3, -0.2, 0.5])
    state, action = base.get_state_dict(), draw_actions(1, 4, seed=5)[0]
    env.step(action)
    expected = base.solver.positions @ rotation.T + translation
    grippers = base.solver.gripper_positions @ rotation.T + translation
    base.set_state_dict(state)
    base.move_worlds(rotation, translation)
    env.step((action.unflatten(1, (-1, 3)) @ rotation.T).flatten(1))
    torch.testing.assert_close(base.solver.gripper_positions, grippers, atol=1e-5, rtol=0)
    # A compressed rope buckles: rounding errors grow within the step, but stay below its radius.
    assert (base.solver.positions - expected).norm(dim=-1).max() < 2e-3


def test_grippers_stop_at_the_table(make_env):
    env = make_env(2)
    env.reset(seed=0)
    radius = env.unwrapped.solver.model.radius
    down = torch.tensor([0.5, 0.0, -1.0]).repeat(2, 4)
    for _ in range(3):
        before = env.unwrapped.solver.gripper_positions.clone()
        env.step(down)
        after = env.unwrapped.solver.gripper_positions
        assert (after[..., 2] >= radius - 1e-6).all()
        assert ((after - before)[..., 0] > 0.01).all()  # they slide on


def test_task_card_has_the_headings_that_the_documentation_generator_expects():
    headings = ["Task Description", "Randomizations", "Success Conditions", "Fail Conditions", "Goal Specification"]
    places = [RopeShapingEnv.__doc__.index(f"**{heading}:**") for heading in headings]
    assert places == sorted(places)
    assert f"at most {RopeShapingEnv.MEAN_DISTANCE_LIMIT} m" in RopeShapingEnv.__doc__
    assert f"at most {RopeShapingEnv.MAX_DISTANCE_LIMIT} m" in RopeShapingEnv.__doc__


def test_policies_see_21_nodes_unless_asked_otherwise_and_shorter_ropes_whole(make_env):
    for options, seen in (({}, 21), ({"graph_nodes": None}, 41), ({"graph_nodes": 30}, 30), ({"resolution": 20}, 20)):
        env = make_env(1, obs_mode="graph", **options)
        graph = env.unwrapped.get_obs()["graph"]
        assert graph["object"]["position"].shape[1] == seen
    with pytest.raises(ValueError, match="graph_nodes must be in"):
        make_env(1, resolution=25, graph_nodes=30)
