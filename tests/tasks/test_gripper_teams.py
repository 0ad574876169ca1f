"""How many grippers there are, which agents drive them, and whether they open."""

import pytest
import torch
from gymnasium import spaces

from maniskill_grpd.tasks.options.grasp_mode import choose_grasp
from maniskill_grpd.tasks.options.gripper_teams import choose_team, gripper_teams


def test_teams_are_all_ways_to_share_the_grippers():
    assert gripper_teams([1, 2]) == ("floating_grippers_1", "floating_grippers_2", ("floating_grippers_1", "floating_grippers_1"))
    # 2^(A-1) ordered ways to write A as a sum
    assert len(gripper_teams([4])) == 8


def test_either_option_determines_the_other():
    assert choose_team(None, None, (2, 3, 4), 4) == (4, "floating_grippers_4")
    assert choose_team(2, None, (2, 3, 4), 4) == (2, "floating_grippers_2")
    assert choose_team(None, "floating_grippers_3", (2, 3, 4), 4) == (3, "floating_grippers_3")
    assert choose_team(None, ["floating_grippers_3"], (2, 3, 4), 4) == (3, "floating_grippers_3")
    pair = ("floating_grippers_1", "floating_grippers_2")
    assert choose_team(None, list(pair), (2, 3, 4), 4) == (3, pair)
    assert choose_team(3, pair, (2, 3, 4), 4) == (3, pair)


def test_contradictions_are_refused():
    with pytest.raises(ValueError, match="num_grippers=2 contradicts"):
        choose_team(2, ("floating_grippers_1", "floating_grippers_2"), (2, 3, 4), 4)
    with pytest.raises(ValueError, match="robot_uids must be one of"):
        choose_team(None, ("floating_grippers_4", "floating_grippers_1"), (2, 3, 4), 4)
    with pytest.raises(ValueError, match=r"grips for \[2, 3\] arms, got 4"):
        choose_team(None, ("panda",) * 4, (2, 3), 2)
    with pytest.raises(ValueError, match="num_grippers=3 contradicts"):
        choose_team(3, ("panda", "xarm7"), (2, 3), 2)
    with pytest.raises(ValueError, match=r"or a tuple of \['panda', 'xarm7'\], got \('panda', 'floating_grippers_1'\)"):
        choose_team(None, ("panda", "floating_grippers_1"), (2, 3), 2)
    with pytest.raises(ValueError, match=r"num_grippers must be one of \[2\], got 1"):
        choose_team(1, None, (2,), 2)


def test_grasp_and_control_mode_go_together():
    modes = ("pd_ee_delta_pos",)
    assert choose_grasp(None, None, modes) == ("fixed", "pd_ee_delta_pos")
    assert choose_grasp("free", None, modes) == ("free", "pd_ee_delta_pos_grip")
    assert choose_grasp(None, "pd_ee_delta_pos_grip", modes) == ("free", "pd_ee_delta_pos_grip")
    assert choose_grasp("free", "pd_joint_pos_grip", (*modes, "pd_joint_pos")) == ("free", "pd_joint_pos_grip")
    assert choose_grasp(None, "pd_joint_pos", (*modes, "pd_joint_pos")) == ("fixed", "pd_joint_pos")
    for grasp, mode, message in (
        ("fixed", "pd_ee_delta_pos_grip", "grasp='fixed' goes with control_mode='pd_ee_delta_pos'"),
        ("open", None, "grasp must be one of"),
        (None, "pd_joint_pos", "control_mode must be one of"),
    ):
        with pytest.raises(ValueError, match=message):
            choose_grasp(grasp, mode, modes)


def test_several_agents_do_what_one_does(make_env, draw_actions):
    """The same worlds under one agent of four grippers and under a team: the same trajectory, bitwise."""
    team = ("floating_grippers_1", "floating_grippers_2", "floating_grippers_1")
    one, several = make_env(3), make_env(3, robot_uids=team)
    assert isinstance(several.action_space, spaces.Dict)
    keys = [f"{uid}-{index}" for index, uid in enumerate(team)]
    assert set(several.action_space) == set(keys)
    assert [several.action_space[key].shape for key in keys] == [(3, 3), (3, 6), (3, 3)]
    one.reset(seed=5), several.reset(seed=5)
    for action in draw_actions(5, 3):
        obs, reward, *_ = one.step(action)
        parts = dict(zip(keys, action.split([3, 6, 3], dim=1), strict=True))
        team_obs, team_reward, *_ = several.step(parts)
        assert torch.equal(reward, team_reward)
        for node_type in ("object", "actuator"):
            for key, value in obs["graph"][node_type].items():
                assert torch.equal(value, team_obs["graph"][node_type][key]), key
    state = several.unwrapped.get_state()
    before = several.unwrapped.get_obs()["graph"]["actuator"]["vectors"]
    several.reset(seed=6)
    several.unwrapped.set_state(state)
    assert torch.equal(several.unwrapped.get_state(), state)
    assert torch.equal(several.unwrapped.get_obs()["graph"]["actuator"]["vectors"], before)


def test_free_grippers_open_and_catch_again(make_env):
    env = make_env(2, grasp="free", num_grippers=2, graph_nodes=None)
    base = env.unwrapped
    assert env.action_space.shape == (2, 8)
    grip = torch.zeros(2, 2, 4)
    grip[..., 2] = 1.0  # up
    grip[..., 3] = 1.0  # closed
    for _ in range(5):
        obs = env.step(grip.flatten(1))[0]
    lifted = base.solver.positions[:, 0, 2].clone()
    assert (lifted > 0.1).all()
    assert (obs["graph"]["actuator"]["scalars"][..., -1] == 1).all()
    grip[0, :, 3] = -1.0  # world 0 lets go
    grip[..., 2] = 0.0
    for _ in range(10):
        obs = env.step(grip.flatten(1))[0]
    assert (base.solver.positions[0, 0, 2] < 0.03).all()
    torch.testing.assert_close(base.solver.positions[1, 0, 2], lifted[1])
    assert obs["graph"]["actuator"]["scalars"][..., -1].tolist() == [[0, 0], [1, 1]]
    assert (obs["graph"]["object"]["scalars"][0, :, 2] == 0).all()
    # down to the rope, and close
    for _ in range(8):
        offset = base.solver.positions[0, [0, 40]] - base.solver.gripper_positions[0]
        grip[0, :, :3] = offset / 0.03
        env.step(grip.flatten(1))
    grip[0, :, 3] = 1.0
    grip[0, :, :3] = torch.tensor([0.0, 0.0, 1.0])
    for _ in range(4):
        obs = env.step(grip.flatten(1))[0]
    assert (base.solver.positions[0, [0, 40], 2] > 0.08).all()
    assert (obs["graph"]["object"]["scalars"][0, [0, 40], 2] == 1).all()
    base.set_state_dict(base.get_state_dict())
    env.step(None)
    assert base.solver.closed.all()
