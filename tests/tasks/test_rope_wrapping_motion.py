"""RopeWrapping-v1 in motion: the rope against the post, symmetry, and what a state holds."""

import math

import pytest
import torch
from post_scenes import ALL_SHAPES, arms, normalized, post_base, ring, rotation_of, straight_on, winding

ENV_ID = "RopeWrapping-v1"
INRADII = {"cylinder": 0.06, "box": 0.05, "prism": 0.04}


@pytest.mark.parametrize("shape", ALL_SHAPES)
def test_a_rope_pulled_against_the_post_stays_on_its_side_and_keeps_its_length(make_env, shape):
    """Straight on at full speed for a whole episode: the way around the post is longer than the grippers are apart."""
    env = make_env(24, shapes=shape, obs_mode="none")
    base = env.unwrapped
    push = straight_on(base)
    start = winding(base)
    for _ in range(100):
        env.step(push)
        edges = base.solver.positions.diff(dim=1).norm(dim=-1)
        assert edges.sum(dim=1).max() < 0.8 * 1.03
        assert arms(base, base.solver.positions).norm(dim=-1).min() > INRADII[shape] + 0.8 * base.solver.model.radius
        assert (winding(base) * start.sign() > start.abs() - 0.05).all()
    assert (winding(base).abs() > 0.6).all()


def test_winding_up_stops_when_the_rope_is_used_up(make_env):
    """Ends that circle against each other: about 0.8 m / (2 pi 0.07 m) turns are there.

    Turns that may lie upon each other: a rope that collides with itself climbs its own turns and is stretched by up to 16 %.
    """
    env = make_env(12, obs_mode="none", self_collision=False)
    base = env.unwrapped
    sense = torch.where(winding(base) < 0.0, -1.0, 1.0)[:, None, None] * torch.tensor([[[-1.0], [1.0]]])
    for _ in range(100):
        grippers = arms(base, base.solver.gripper_positions)
        around = torch.linalg.cross(base.post_rotation[:, None, :, 2].expand(-1, 2, -1), grippers)
        env.step((sense * around / 0.07).flatten(1))
        assert base.solver.positions.diff(dim=1).norm(dim=-1).sum(dim=1).max() < 0.8 * 1.1
    assert ((winding(base).abs() > 1.0) & (winding(base).abs() < 0.82 / (2 * math.pi * 0.07))).all()


def test_a_rope_is_held_back_around_the_post_but_not_above_it(make_env):
    """Wound up almost taut; both ends go outward."""
    env = make_env(2, obs_mode="none")
    base = env.unwrapped
    spirals = torch.stack([ring(radius=0.07, turns=1.8, height=height) for height in (0.01, 0.2)])
    base.solver.reset(torch.arange(2), spirals + post_base(base), torch.tensor([0, 40]))
    start = base.solver.gripper_positions.clone()
    env.step(normalized(arms(base, start)).flatten(1))
    moved = (base.solver.gripper_positions - start).norm(dim=-1)
    assert (moved[0] < 0.027).all()
    assert (moved[1] > 0.0299).all()


def test_free_grippers_let_go_of_the_rope_and_of_its_limits(make_env):
    env = make_env(4, grasp="free", obs_mode="none")
    base = env.unwrapped
    open_and_go = torch.tensor([1.0, 0.0, 0.3, -1.0, -1.0, 0.0, 0.3, -1.0]).repeat(4, 1)
    for _ in range(60):
        env.step(open_and_go)
    assert not base.solver.closed.any()
    assert ((base.solver.gripper_positions[:, 0] - base.solver.gripper_positions[:, 1]).norm(dim=-1) > 1.5).all()
    assert (base.solver.positions[..., 2] < 0.05).all()


# ---------------------------------------------------------------------- symmetry and state


@pytest.fixture
def half_wrapped_env(make_env):
    """Worlds in motion, in one of them with the rope closed around the post."""
    env = make_env(4, shapes=ALL_SHAPES)
    base = env.unwrapped
    push = straight_on(base)
    for _ in range(8):
        env.step(push)
    base.solver.positions[0] = ring() + post_base(base)[0]
    return env


@pytest.mark.parametrize("seed", range(5))
def test_reward_success_and_graph_do_not_depend_on_the_frame(half_wrapped_env, seed):
    base = half_wrapped_env.unwrapped
    info, graph = base.get_info(), base.get_obs()["graph"]
    reward = base.get_reward(None, None, info)
    assert info["success"].tolist() == [True, False, False, False]
    rotation, shift = rotation_of(seed), torch.tensor([0.5, -1.0, 0.3])
    base.move_worlds(rotation, shift)
    moved_info, moved = base.get_info(), base.get_obs()["graph"]
    assert torch.equal(moved_info["success"], info["success"])
    torch.testing.assert_close(base.get_reward(None, None, moved_info), reward, atol=2e-6, rtol=0)
    for kind in ("object", "actuator"):
        torch.testing.assert_close(moved[kind]["scalars"], graph[kind]["scalars"], atol=3e-6, rtol=0)
        torch.testing.assert_close(moved[kind]["vectors"], graph[kind]["vectors"] @ rotation.T, atol=5e-6, rtol=0)
        torch.testing.assert_close(moved[kind]["position"], graph[kind]["position"] @ rotation.T + shift, atol=2e-6, rtol=0)


def test_moving_the_post_alone_changes_the_reward(half_wrapped_env):
    """Negative control of the test above."""
    base = half_wrapped_env.unwrapped
    reward = base.get_reward(None, None, base.get_info())
    base.solver.collider_positions[..., :2] += 0.5
    assert (base.get_reward(None, None, base.get_info()) - reward).abs().min() > 1e-2


def test_steps_commute_with_moving_the_worlds(make_env):
    """Also where the way around the post limits the grippers: the last of these steps pull the rope taut."""
    env = make_env(6, shapes=ALL_SHAPES, obs_mode="none")
    base = env.unwrapped
    push = straight_on(base)
    for _ in range(25):
        env.step(push)
    state = base.get_state_dict()
    env.step(push)
    assert (base.agent.robot.qvel.unflatten(1, (2, 3)).norm(dim=-1) < 0.59).any(), "the limit is at work"
    rotation, shift = rotation_of(0), torch.tensor([0.5, -1.0, 0.3])
    expected = base.solver.positions @ rotation.T + shift, base.solver.gripper_positions @ rotation.T + shift
    base.set_state_dict(state)
    base.move_worlds(rotation, shift)
    env.step((push.unflatten(1, (2, 3)) @ rotation.T).flatten(1))
    torch.testing.assert_close(base.solver.gripper_positions, expected[1], atol=1e-4, rtol=0)
    assert (base.solver.positions - expected[0]).norm(dim=-1).max() < 2e-3


def test_a_restored_state_has_the_same_future(make_env):
    env = make_env(6, shapes=ALL_SHAPES)
    other = make_env(6, shapes=ALL_SHAPES)
    other.reset(seed=77)
    generator = torch.Generator().manual_seed(0)
    actions = torch.randn(12, 6, 6, generator=generator)
    for action in actions[:6]:
        env.step(action)
    other.unwrapped.set_state(env.unwrapped.get_state())
    for action in actions[6:]:
        here, there = env.step(action), other.step(action)
        assert torch.equal(here[1], there[1])
        assert torch.equal(here[0]["graph"]["object"]["vectors"], there[0]["graph"]["object"]["vectors"])
    assert torch.equal(env.unwrapped.get_state(), other.unwrapped.get_state())


def test_a_world_does_not_depend_on_its_place_in_the_batch(make_env):
    """To the bit, also where the way around the post limits the grippers."""
    many, few = make_env(20, shapes=ALL_SHAPES, obs_mode="none"), make_env(3, shapes=ALL_SHAPES, obs_mode="none")
    many.reset(seed=list(range(20)))
    few.reset(seed=[5, 6, 7])
    push = straight_on(many.unwrapped)
    for _ in range(30):
        many.step(push)
        few.step(push[5:8])
    here, there = many.unwrapped.solver, few.unwrapped.solver
    assert torch.equal(here.gripper_positions[5:8], there.gripper_positions)
    assert torch.equal(here.positions[5:8], there.positions)


def test_resets_of_some_worlds_leave_the_others_alone(make_env):
    env, untouched = make_env(5, shapes=ALL_SHAPES), make_env(5, shapes=ALL_SHAPES)
    push = straight_on(env.unwrapped)
    for _ in range(10):
        env.step(push)
        untouched.step(push)
    env.reset(seed=[100, 101], options={"env_idx": torch.tensor([1, 3])})
    fresh = make_env(2, shapes=ALL_SHAPES)
    fresh.reset(seed=[100, 101])
    kept = [0, 2, 4]
    for name in ("positions", "collider_positions", "collider_rotations", "collider_active"):
        here = getattr(env.unwrapped.solver, name)
        assert torch.equal(here[kept], getattr(untouched.unwrapped.solver, name)[kept])
        assert torch.equal(here[[1, 3]], getattr(fresh.unwrapped.solver, name))
    for _ in range(5):
        env.step(push)
        untouched.step(push)
    assert torch.equal(env.unwrapped.solver.positions[kept], untouched.unwrapped.solver.positions[kept])
