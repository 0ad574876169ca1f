"""The expert of RopeWrapping-v1."""

import math

import gymnasium as gym
import pytest
import torch
from scipy.spatial.transform import Rotation

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.experts import make_expert

FIRST_SEED = 1_000_000
"""Seeds that the expert's constants were not chosen on."""


@pytest.fixture
def make_env():
    """Return a function that makes RopeWrapping-v1 on the CPU, reset with unseen seeds."""
    made = []

    def make(num_envs, **options):
        settings = {"sim_backend": "cpu", "render_backend": "none", "obs_mode": "none", **options}
        made.append(gym.make("RopeWrapping-v1", num_envs=num_envs, **settings))
        made[-1].reset(seed=list(range(FIRST_SEED, FIRST_SEED + num_envs)))
        return made[-1]

    yield make
    for env in made:
        env.close()


def play(env, choose, num_steps=100):
    """Play one episode; return success at each step (T, B) and the last reward (B,)."""
    success = []
    for _ in range(num_steps):
        _, reward, _, _, info = env.step(choose())
        success.append(info["success"])
    return torch.stack(success), reward


@pytest.mark.parametrize(
    ("num_envs", "options"),
    [
        (200, {}),
        (100, {"shapes": "box"}),
        (100, {"shapes": "prism"}),
        (32, {"shapes": ("cylinder", "box", "prism"), "resolution": (20, 80)}),
        (32, {"material": {"stretch": (0.5, 2), "bend": (0.1, 10), "mass": (0.5, 2), "friction": (0.5, 2)}}),
        (32, {"grasp": "free"}),
    ],
)
def test_expert_solves_the_task_and_holds_the_rope_closed(make_env, num_envs, options):
    env = make_env(num_envs, **options)
    success, reward = play(env, make_expert("RopeWrapping-v1", env).act)
    assert success[-1].float().mean() >= 0.95
    assert success[50:].all(dim=0).float().mean() >= 0.95
    assert reward.mean() > 0.9


def test_actions_are_within_the_limit_of_the_controller(make_env):
    for grasp, width in {"fixed": 6, "free": 8}.items():
        env = make_env(8, grasp=grasp)
        expert = make_expert("RopeWrapping-v1", env)
        for _ in range(30):
            action = expert.act()
            assert action.shape == (8, width)
            motion = action.unflatten(1, (2, -1))
            assert motion[..., :3].norm(dim=-1).max() <= 1.0 + 1e-6
            assert (motion[..., 3:] == 1.0).all()
            env.step(action)


def test_actions_turn_with_the_worlds(make_env):
    env = make_env(8, shapes=("cylinder", "box", "prism"))
    expert = make_expert("RopeWrapping-v1", env)
    rotation = torch.as_tensor(Rotation.random(random_state=2).as_matrix(), dtype=torch.float32)
    for _ in range(4):
        play(env, expert.act, 5)
        state, action = env.unwrapped.get_state_dict(), expert.act().unflatten(1, (2, 3))
        env.unwrapped.move_worlds(rotation, torch.tensor([0.3, 0.7, -0.2]))
        torch.testing.assert_close(expert.act().unflatten(1, (2, 3)), action @ rotation.T, atol=2e-4, rtol=0)
        env.unwrapped.set_state_dict(state)


def test_action_is_a_continuous_function_of_the_grippers(make_env):
    """A threshold would be a jump that no network can imitate.

    A gripper that moves by 0.1 mm at 0.07 m or more from the axis moves its target by 0.13 / 0.07 of that at most: the way there
    changes by 0.3 mm, a hundredth of a step.
    """
    env = make_env(32)
    expert = make_expert("RopeWrapping-v1", env)
    grippers, generator = env.unwrapped.solver.gripper_positions, torch.Generator().manual_seed(0)
    for _ in range(30):
        action, kept = expert.act(), grippers.clone()
        grippers += 1e-4 * torch.nn.functional.normalize(torch.randn(grippers.shape, generator=generator), dim=-1)
        assert (expert.act() - action).unflatten(1, (2, 3)).norm(dim=-1).max() < 0.011
        grippers.copy_(kept)
        env.step(action)


def test_expert_goes_on_after_disturbances(make_env):
    env = make_env(64)
    expert = make_expert("RopeWrapping-v1", env)
    generator = torch.Generator().manual_seed(0)
    success, _ = play(env, lambda: expert.act() + 0.3 * torch.randn(64, 6, generator=generator))
    assert success[-1].float().mean() >= 0.9


def test_expert_unwinds_a_rope_that_was_wound_too_far(make_env):
    env = make_env(4)
    base, expert = env.unwrapped, make_expert("RopeWrapping-v1", env)
    angle = 2 * math.pi * torch.linspace(0.0, 1.4, 41)
    spiral = torch.stack([0.09 * angle.cos(), 0.09 * angle.sin(), torch.full((41,), 0.01)], dim=-1)
    floor = base.solver.collider_positions[:, :1] * torch.tensor([1.0, 1.0, 0.0])
    base.solver.reset(torch.arange(4), spiral + floor, torch.tensor([0, 40]))
    assert not base.evaluate()["success"].any()
    success, _ = play(env, expert.act, 40)
    assert success[-1].all()


def test_worlds_that_reset_midway_start_over_and_leave_the_others_alone(make_env):
    env = make_env(6)
    expert = make_expert("RopeWrapping-v1", env)
    play(env, expert.act, 8)
    before = expert.act()
    env.reset(seed=[1, 2], options={"env_idx": torch.tensor([1, 4])})
    after = expert.act()
    kept = [0, 2, 3, 5]
    assert torch.equal(after[kept], before[kept])
    assert not torch.allclose(after[[1, 4]], before[[1, 4]])
    assert play(env, expert.act, 40)[0][-1].all()
