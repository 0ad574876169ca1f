"""From scene to gripper motion: observation, normaliser, policy and controller together are SE(3)-equivariant."""

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from maniskill_grpd.policies import make_policy


@pytest.fixture
def scene(make_env, draw_actions):
    """Worlds in motion above the table, and a policy whose actions are partly beyond the limit of the controller."""
    env = make_env(16, shapes=("W", "S", "spiral"))
    base = env.unwrapped
    policy = make_policy("grpd", base.graph_schema, magnitude="softplus")
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter += 0.1 * torch.randn(parameter.shape, generator=generator)
    for action in draw_actions(8, 16):
        action.view(16, 4, 3)[..., 2].abs_()
        env.step(action)
        policy.normalizer.update(base.get_obs()["graph"])
    with torch.no_grad():
        # Shift the magnitudes until half the actions are longer than the controller lets them be.
        for _ in range(10):
            lengths = policy.distribution(base.get_obs()["graph"]).mean.norm(dim=-1)
            policy.mean.length.bias += 1.0 - lengths.median()
    return base, policy


def gripper_motion(base, policy, *, per_axis_limit=False) -> torch.Tensor:
    """Return how the controller would move the grippers for the policy's mean action, (B, A, 3) [m]."""
    with torch.no_grad():
        action = policy.act(base.get_obs()["graph"], deterministic=True)
    before = base.agent.robot.drive_targets.clone()
    base.agent.set_action(action.clamp(-1.0, 1.0) if per_axis_limit else action)
    return (base.agent.robot.drive_targets - before).unflatten(1, (-1, 3))


def largest_relative_error(base, policy, seed: int, **limit) -> tuple[float, torch.Tensor]:
    state = base.get_state_dict()
    expected = gripper_motion(base, policy, **limit)
    base.set_state_dict(state)
    rotation = torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)
    # A shift by the size of the scene: positions further away round more coarsely than the motion is small.
    translation = 0.2 * torch.randn(3, generator=torch.Generator().manual_seed(seed))
    base.move_worlds(rotation, translation)
    motion = gripper_motion(base, policy, **limit)
    base.set_state_dict(state)
    error = (motion - expected @ rotation.T).norm(dim=-1).max() / expected.norm(dim=-1).max()
    return error.item(), expected


def test_the_whole_act_path_is_equivariant_in_float32(scene):
    base, policy = scene

    @given(st.integers(0, 10_000))
    @settings(max_examples=25)
    def check(seed):
        error, motion = largest_relative_error(base, policy, seed)
        assert error <= 1e-5
        # The test means something: some actions are limited, others are not, and none is zero.
        lengths = motion.norm(dim=-1)
        assert lengths.max() == pytest.approx(0.03, rel=1e-4)
        assert lengths.min() < 0.0299

    check()


def test_a_limit_per_axis_breaks_the_symmetry(scene):
    """Negative control: the clamp that most environments use."""
    base, policy = scene
    assert max(largest_relative_error(base, policy, seed, per_axis_limit=True)[0] for seed in range(5)) > 1e-2
