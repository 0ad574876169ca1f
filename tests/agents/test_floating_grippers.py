"""The grippers' controller: limited by length, equivariant, stopped by the table."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from mani_skill.agents import REGISTERED_AGENTS
from scipy.spatial.transform import Rotation

import maniskill_grpd.agents  # noqa: F401  (registers)

STEP = 0.03


def make_grippers(num_worlds=3, num_grippers=4, control_mode=None):
    """Return an agent on a stub of the scene: tensors and a clock."""
    solver = SimpleNamespace(
        gripper_positions=torch.zeros(num_worlds, num_grippers, 3), gripper_targets=torch.zeros(num_worlds, num_grippers, 3)
    )
    scene = SimpleNamespace(
        solver=solver,
        num_envs=num_worlds,
        device=torch.device("cpu"),
        px=SimpleNamespace(timestep=1 / 20),
        gpu_sim_enabled=False,
        _gpu_sim_initialized=False,
        _reset_mask=torch.ones(num_worlds, dtype=torch.bool),
        state_dict_registry=SimpleNamespace(articulations={}),
        grip_commands=torch.ones(num_worlds, num_grippers, dtype=torch.bool),
        claim_grippers=lambda num: slice(0, num),
    )
    agent_cls = REGISTERED_AGENTS[f"floating_grippers_{num_grippers}"].agent_cls
    return agent_cls(scene, control_freq=20, control_mode=control_mode)


def displacements(action):
    """Return how far each gripper's target moves, (B, A, 3), without a table."""
    num_worlds, width = action.shape
    agent = make_grippers(num_worlds, width // 3)
    agent.set_action(action)
    return agent.robot.drive_targets.unflatten(1, (-1, 3)).clone()


def random_rotation(seed):
    return torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)


@pytest.mark.parametrize("num_grippers", [1, 2, 3, 4])
def test_is_registered_with_a_normalised_action_space(num_grippers):
    agent = make_grippers(5, num_grippers)
    space = agent.single_action_space
    assert agent.control_mode == "pd_ee_delta_pos"
    assert space.shape == (3 * num_grippers,)
    assert agent.action_space.shape == (5, 3 * num_grippers)
    assert (space.low == -1).all()
    assert (space.high == 1).all()


def test_grip_mode_adds_a_number_per_gripper_that_closes_it_while_positive():
    agent = make_grippers(2, 2, control_mode="pd_ee_delta_pos_grip")
    assert agent.single_action_space.shape == (8,)
    assert (agent.single_action_space.low == -1).all()
    assert (agent.single_action_space.high == 1).all()
    action = torch.tensor([[1.0, 0, 0, -1.0, 0, 2.0, 0, 0.5], [0, 0, 0, 1.0, 0, 0, 0, 0.0]])
    agent.set_action(action)
    moved = agent.robot.drive_targets.unflatten(1, (-1, 3))
    torch.testing.assert_close(moved[0], torch.tensor([[STEP, 0, 0], [0, STEP, 0]]))
    assert not moved[1].any()
    assert agent.scene.grip_commands.tolist() == [[False, True], [True, False]]
    with pytest.raises(ValueError, match="must have shape \\(2, 8\\)"):
        agent.set_action(action[:, :6])
    with pytest.raises(ValueError, match="in world 1 for gripper 1"):
        agent.set_action(torch.tensor([[0.0] * 8, [0.0] * 7 + [float("nan")]]))


@given(st.integers(0, 10_000), st.floats(0.01, 100.0))
def test_displacement_has_the_direction_of_the_action_and_a_limited_length(seed, scale):
    action = torch.randn(2, 12, generator=torch.Generator().manual_seed(seed)) * scale
    vectors = action.unflatten(1, (-1, 3))
    length = vectors.norm(dim=-1, keepdim=True)
    # step * a where |a| <= 1, step * a / |a| beyond
    torch.testing.assert_close(displacements(action), STEP * vectors / length.clamp_min(1.0))


@given(st.integers(0, 10_000))
def test_controller_commutes_with_rotations(seed):
    action = 2.0 * torch.randn(1, 12, generator=torch.Generator().manual_seed(seed))
    rotation = random_rotation(seed)
    rotated = (action.unflatten(1, (-1, 3)) @ rotation.T).flatten(1)
    torch.testing.assert_close(displacements(rotated), displacements(action) @ rotation.T, atol=1e-7, rtol=0)


def test_a_limit_per_axis_would_not_commute_with_rotations():
    """Negative control of the test above: it can tell a cube from a ball."""
    action, rotation = 2.0 * torch.randn(1, 4, 3), random_rotation(0)
    per_axis = STEP * (action @ rotation.T).clamp(-1, 1), STEP * action.clamp(-1, 1) @ rotation.T
    assert (per_axis[0] - per_axis[1]).abs().max() > 0.1 * STEP


def test_large_finite_actions_do_not_overflow():
    action = torch.full((1, 12), 3e38)
    torch.testing.assert_close(displacements(action), torch.full((1, 4, 3), STEP / 3**0.5))


def test_zero_action_leaves_targets_bitwise_unchanged():
    agent = make_grippers()
    agent.robot.drive_targets.normal_()
    before = agent.robot.drive_targets.clone()
    agent.set_action(torch.zeros(3, 12))
    assert torch.equal(agent.robot.drive_targets, before)


@pytest.mark.parametrize("kind", ["float64", "int64", "requires_grad"])
def test_accepts_other_tensors_of_numbers(kind):
    action = torch.ones(3, 12, dtype=getattr(torch, kind, torch.float32))
    agent = make_grippers()
    agent.set_action(action.requires_grad_() if kind == "requires_grad" else action)
    assert not agent.robot.drive_targets.requires_grad
    torch.testing.assert_close(agent.robot.drive_targets, torch.full((3, 12), STEP / 3**0.5))


@given(st.integers(0, 10_000))
def test_targets_stop_above_a_tilted_table_and_move_along_its_normal(seed):
    agent = make_grippers(1, 4)
    normal = random_rotation(seed)[2]
    clearance, offset = 0.01, 0.2
    agent.robot.set_floor(torch.cat([normal, torch.tensor([offset])])[None], clearance)
    start = torch.randn(1, 4, 3, generator=torch.Generator().manual_seed(seed)) * 0.3
    start += normal * (0.02 + offset + clearance - start @ normal).clamp_min(0.0)[..., None]
    agent.robot.drive_targets.copy_(start.flatten(1))
    agent.set_action(torch.randn(1, 12, generator=torch.Generator().manual_seed(seed + 1)))
    wanted = start + displacements(torch.randn(1, 12, generator=torch.Generator().manual_seed(seed + 1)))
    reached = agent.robot.drive_targets.unflatten(1, (-1, 3))
    assert (reached @ normal >= offset + clearance - 1e-6).all()
    corrected = reached - wanted
    torch.testing.assert_close(corrected, (corrected @ normal)[..., None] * normal, atol=1e-6, rtol=0)
    is_above = wanted @ normal >= offset + clearance
    assert (corrected[is_above].abs() < 1e-6).all()


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_refuses_actions_that_are_not_finite_and_says_which(value):
    agent = make_grippers()
    action = torch.zeros(3, 12)
    action[1, 7] = value
    with pytest.raises(ValueError, match=rf"must be finite.*{value}.*world 1.*gripper 2"):
        agent.set_action(action)
    assert (agent.robot.drive_targets == 0).all()


@pytest.mark.parametrize("shape", [(12,), (3, 11), (2, 12), (3, 4, 3), (1, 3, 12)])
def test_refuses_actions_of_the_wrong_shape_and_says_the_right_one(shape):
    with pytest.raises(ValueError, match=r"must have shape \(3, 12\), got"):
        make_grippers().set_action(torch.zeros(shape))


def test_controller_state_is_a_copy_and_restores_chosen_worlds():
    agent = make_grippers()
    agent.set_action(torch.rand(3, 12))
    state = agent.get_controller_state()
    saved = state["target_qpos"].clone()
    agent.set_action(torch.rand(3, 12))
    assert torch.equal(state["target_qpos"], saved)
    moved = agent.robot.drive_targets.clone()
    agent.controller.set_state({"target_qpos": saved[[2]]}, torch.tensor([2]))
    assert torch.equal(agent.robot.drive_targets[2], saved[2])
    assert torch.equal(agent.robot.drive_targets[:2], moved[:2])


def test_velocity_is_displacement_over_time():
    agent = make_grippers(2, 1)
    agent.robot.start_motion()
    agent.scene.solver.gripper_positions += torch.tensor([0.01, 0.0, -0.02])
    agent.robot.finish_motion(0.05)
    torch.testing.assert_close(agent.robot.get_qvel(), torch.tensor([[0.2, 0.0, -0.4]]).repeat(2, 1))


def test_setters_write_only_the_worlds_being_reset():
    agent = make_grippers()
    agent.scene._reset_mask[:] = torch.tensor([True, False, True])
    agent.robot.set_qpos(torch.ones(2, 12))
    agent.robot.set_qvel(np.full(12, 2.0, dtype=np.float32))
    assert agent.robot.get_qpos()[:, 0].tolist() == [1, 0, 1]
    assert agent.robot.get_qvel()[:, 0].tolist() == [2, 0, 2]


def test_articulation_state_round_trips_in_any_order_of_worlds():
    agent = make_grippers()
    agent.robot.qpos.normal_()
    agent.robot.qvel.normal_()
    state = agent.robot.get_state()
    agent.robot.qpos.zero_()
    agent.robot.qvel.zero_()
    order = torch.tensor([2, 0, 1])
    agent.robot.set_state(state[order], order)
    assert torch.equal(agent.robot.get_state(), state)
