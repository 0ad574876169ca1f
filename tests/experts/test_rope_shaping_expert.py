"""The expert of RopeShaping-v1 and how experts are made."""

import gymnasium as gym
import mani_skill.envs  # noqa: F401
import pytest
import torch
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.experts import make_expert
from maniskill_grpd.experts.rope_shaping_expert import _trailing_direction

FIRST_SEED = 3_000_000
"""Seeds that the expert's constants were not chosen on."""


def make_env(num_envs, **options):
    settings = {"sim_backend": "cpu", "render_backend": "none", "obs_mode": "none", **options}
    env = gym.make("RopeShaping-v1", num_envs=num_envs, **settings)
    env.reset(seed=list(range(FIRST_SEED, FIRST_SEED + num_envs)))
    return env


def play(env, choose, num_steps=100):
    """Play one episode and return the last info."""
    for _ in range(num_steps):
        *_, info = env.step(choose())
    return info


def test_expert_solves_the_default_task_on_200_seeds():
    """The task is solvable as defined; nearly always, and with room to spare."""
    env = make_env(200)
    info = play(env, make_expert("RopeShaping-v1", env).act)
    assert info["success"].float().mean() >= 0.9
    assert info["mean_distance"].mean() < 0.02
    env.close()


def test_going_straight_to_the_goal_does_not_solve_it():
    """Negative control: it is the laying that solves the task, not the task that is easy."""
    env = make_env(100)
    base = env.unwrapped

    def straight():
        held = base.goal_positions[:, base.start_nodes[0]]
        return ((held - base.solver.gripper_positions) / 0.03).flatten(1)

    assert play(env, straight)["success"].float().mean() < 0.6
    env.close()


@pytest.mark.parametrize(("num_grippers", "shape"), [(4, "U"), (4, "V"), (4, "L"), (4, "O"), (3, "W"), (3, "V"), (3, "L")])
def test_expert_solves_other_tasks_whose_spans_bulge_to_one_side(num_grippers, shape):
    env = make_env(32, num_grippers=num_grippers, goal_shape=shape)
    info = play(env, make_expert("RopeShaping-v1", env).act)
    assert info["success"].float().mean() >= 0.8
    env.close()


def test_actions_are_within_the_limit_of_the_controller():
    env = make_env(8)
    expert = make_expert("RopeShaping-v1", env)
    for _ in range(60):
        action = expert.act()
        assert action.shape == (8, 12)
        assert action.unflatten(1, (4, 3)).norm(dim=-1).max() <= 1.0 + 1e-6
        env.step(action)
    env.close()


def test_expert_goes_on_after_disturbances():
    """Grippers that are pushed off the path come back to it: actions with noise of 0.3 steps."""
    env = make_env(64)
    expert = make_expert("RopeShaping-v1", env)
    generator = torch.Generator().manual_seed(0)

    def disturbed():
        action = expert.act()
        return action + 0.3 * torch.randn(action.shape, generator=generator)

    assert play(env, disturbed)["success"].float().mean() >= 0.9
    env.close()


def test_worlds_that_reset_midway_start_over_and_leave_the_others_alone():
    """The action is a function of the state alone, so a partial reset needs no word to it."""
    env = make_env(6)
    expert = make_expert("RopeShaping-v1", env)
    play(env, expert.act, 20)
    before = expert.act()
    env.reset(seed=[1, 2], options={"env_idx": torch.tensor([1, 4])})
    after = expert.act()
    kept = [0, 2, 3, 5]
    torch.testing.assert_close(after[kept], before[kept], rtol=0, atol=0)
    assert not torch.allclose(after[[1, 4]], before[[1, 4]])
    assert play(env, expert.act, 60)["success"].all()
    env.close()


def test_action_is_a_continuous_function_of_the_state():
    """A threshold would be a jump that no network can imitate.

    Moving all grippers by 0.1 mm moves a target by at most 0.1 mm (1 + |w| max h' + 1) with
    |w| = 0.27 m, max h' = 1.5 / 0.06 m; in steps of 3 cm that is 0.03.
    """
    env = make_env(64)
    expert = make_expert("RopeShaping-v1", env)
    grippers = env.unwrapped.solver.gripper_positions
    for _ in range(40):
        action = expert.act()
        kept = grippers.clone()
        grippers += 1e-4 * torch.nn.functional.normalize(torch.randn(grippers.shape), dim=-1)
        assert (expert.act() - action).unflatten(1, (4, 3)).norm(dim=-1).max() < 0.04
        grippers.copy_(kept)
        env.step(action)
    env.close()


def test_state_determines_the_action():
    """Restoring a state restores the action, also in the middle of the drag."""
    env = make_env(4)
    expert = make_expert("RopeShaping-v1", env)
    play(env, expert.act, 25)
    state, action = env.unwrapped.get_state_dict(), expert.act()
    play(env, expert.act, 30)
    env.unwrapped.set_state_dict(state)
    torch.testing.assert_close(expert.act(), action, rtol=0, atol=0)
    env.close()


def test_expert_acts_through_a_vector_environment():
    env = ManiSkillVectorEnv(make_env(3, max_episode_steps=5), record_metrics=True)
    expert = make_expert("RopeShaping-v1", env)
    env.reset(seed=0)
    for _ in range(7):  # beyond the automatic reset
        env.step(expert.act())
    assert torch.isfinite(expert.act()).all()
    env.close()


def test_direction_is_the_side_to_which_the_spans_bulge():
    """A triangle over its ends: the mean of (0, 0), (1, 1), (2, 0) is a third above the chord."""
    goals = torch.tensor([[[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 0.0, 0.0]]])
    expected = torch.tensor([[0.0, 1.0, 0.0]])
    torch.testing.assert_close(_trailing_direction(goals, torch.tensor([[0, 2]])), expected)


def test_direction_turns_with_the_goal():
    goals = torch.randn(5, 21, 3, dtype=torch.float64) * torch.tensor([1.0, 1.0, 0.0])
    turn = torch.tensor([[0.6, -0.8, 0.0], [0.8, 0.6, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64)
    direction = _trailing_direction(goals, torch.tensor([[0, 5, 15, 20]]))
    turned = _trailing_direction(goals @ turn.T + 3.0, torch.tensor([[0, 5, 15, 20]]))
    torch.testing.assert_close(turned, direction @ turn.T, rtol=1e-9, atol=1e-9)


def test_goals_without_a_side_are_approached_along_their_chord():
    """Point-symmetric S: bulges cancel, and a direction made of rounding would be arbitrary."""
    angle = torch.linspace(-torch.pi, torch.pi, 41)
    goals = torch.stack([angle, angle.sin(), 0.0 * angle], dim=-1)[None]
    chord = torch.tensor([[1.0, 0.0, 0.0]])
    torch.testing.assert_close(_trailing_direction(goals, torch.tensor([[0, 20, 40]])), chord)


def test_unknown_tasks_and_other_environments_are_refused():
    with pytest.raises(ValueError, match=r"'Cooking-v1' has no expert.*RopeShaping-v1"):
        make_expert("Cooking-v1", None)
    other = gym.make("Empty-v1", render_backend="none", sim_backend="cpu")
    with pytest.raises(ValueError, match="acts in a RopeShapingEnv, got a EmptyEnv"):
        make_expert("RopeShaping-v1", other)
    other.close()
