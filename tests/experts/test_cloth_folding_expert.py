"""The expert of ClothFolding-v1, and what it shows about the task."""

import gymnasium as gym
import mani_skill.envs  # noqa: F401
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.experts import make_expert

FIRST_SEED = 1_000_000
"""Seeds that the expert's constants were not chosen on."""


@pytest.fixture
def make_folding():
    """Return a function that makes ClothFolding-v1 on the CPU, reset with unseen seeds."""
    made = []

    def make(num_envs, **options):
        settings = {"sim_backend": "cpu", "render_backend": "none", "obs_mode": "none", **options}
        made.append(gym.make("ClothFolding-v1", num_envs=num_envs, **settings))
        made[-1].reset(seed=list(range(FIRST_SEED, FIRST_SEED + num_envs)))
        return made[-1]

    yield make
    for env in made:
        env.close()


def play(env, choose, num_steps=40):
    """Play and return the rewards (T, B) and the last info."""
    rewards = []
    for _ in range(num_steps):
        _, reward, _, _, info = env.step(choose())
        rewards.append(reward)
    return torch.stack(rewards), info


def penetrations(model, positions):
    """Return how much nearer than its thickness each node (N,) is to triangles that are farther away in the cloth [m]."""
    triangles = positions[model.faces]
    around = model.geodesics[:, model.faces].min(axis=2)
    nodes, faces = np.nonzero(around > 6.0 * model.radius + model.rest_lengths.max())
    closest = trimesh.triangles.closest_point(triangles[faces], positions[nodes])
    gaps = np.full(model.num_nodes, np.inf)
    np.minimum.at(gaps, nodes, np.linalg.norm(closest - positions[nodes], axis=1))
    return np.maximum(2.0 * model.radius - gaps, 0.0)


def test_expert_folds_and_holds(make_folding):
    env = make_folding(32)
    expert = make_expert("ClothFolding-v1", env)
    play(env, expert.act)
    _, info = play(env, expert.act, num_steps=10)
    assert info["success"].float().mean() >= 0.9
    assert info["fold_distance"].mean() < 0.012
    assert info["drift"].mean() < 0.006


@pytest.mark.slow
@pytest.mark.parametrize("num_grippers", [1, 2])
def test_expert_solves_the_task_on_200_seeds(make_folding, num_grippers):
    """The task is solvable as defined, to the end of the episode."""
    env = make_folding(200, num_grippers=num_grippers)
    _, info = play(env, make_expert("ClothFolding-v1", env).act, num_steps=100)
    assert info["success"].float().mean() >= 0.9


@pytest.mark.parametrize(
    "options",
    [
        {"num_grippers": 1},
        {"grasp": "free"},
        {"shapes": ("square", "rectangle", "triangle", "hexagon", "circle", "l_shape")},
        {"resolution": (100, 225)},
        {"material": {"bend": (0.1, 10.0), "stretch": (0.5, 2.0), "mass": (0.5, 2.0), "friction": (0.5, 2.0)}},
    ],
)
def test_expert_folds_other_configurations(make_folding, options):
    env = make_folding(20, **options)
    _, info = play(env, make_expert("ClothFolding-v1", env).act)
    assert info["success"].float().mean() >= 0.9
    assert env.unwrapped.solver.closed.all()


def test_dragging_over_the_table_is_not_a_way(make_folding):
    """Negative control: it is the lifting that solves the task, and self-contact that stops everything else."""
    env = make_folding(32)
    base = env.unwrapped

    def drag():
        goals = base.goal_positions.gather(1, base.start_nodes[..., None].expand(-1, -1, 3))
        return ((goals - base.solver.gripper_positions) / 0.03).flatten(1)

    dragged, info = play(env, drag)
    assert not info["success"].any()
    env = make_folding(32)
    folded, _ = play(env, make_expert("ClothFolding-v1", env).act)
    assert (folded.sum(dim=0) > 3.0 * dragged.sum(dim=0)).all()


def test_folded_cloths_lie_in_two_layers_that_do_not_penetrate(make_folding):
    env = make_folding(16)
    base = env.unwrapped
    model, radius = base.models[0], base.models[0].radius
    play(env, make_expert("ClothFolding-v1", env).act)
    positions = base.solver.positions.numpy()
    depths = np.concatenate([penetrations(model, world) for world in positions])
    assert np.quantile(depths, 0.99) < 0.5 * radius
    # Away from the fold, where the layers bulge, the moving half lies one thickness above the other.
    beyond = ((base.goal_positions - base.crease_ends[:, :1]) * base.crease_normal[:, None]).sum(-1)
    upper = (base.is_moving > 0) & (beyond < -0.06)
    lower = (base.is_moving == 0) & (beyond < -0.06)
    height = base.solver.positions[..., 2]
    assert 2.0 * radius < height[upper].median() < 5.0 * radius
    assert height[lower].median() < 1.2 * radius


def test_penetrations_are_seen():
    """Negative control of the measure above."""
    env = gym.make("ClothFolding-v1", sim_backend="cpu", render_backend="none", obs_mode="none")
    env.reset(seed=0)
    base = env.unwrapped
    flattened = base.goal_positions[0].numpy() * [1, 1, 0]
    assert np.quantile(penetrations(base.models[0], flattened), 0.9) > base.models[0].radius
    env.close()


@pytest.mark.parametrize("num_grippers", [1, 2])
def test_actions_depend_on_the_state_alone_and_are_as_long_as_allowed(make_folding, num_grippers):
    env = make_folding(4, num_grippers=num_grippers, resolution=49)
    base, expert = env.unwrapped, make_expert("ClothFolding-v1", env)
    actions, states = [], []
    for _ in range(8):
        states.append(base.get_state_dict())
        actions.append(expert.act())
        env.step(actions[-1])
    for state, action in reversed(list(zip(states, actions, strict=True))):
        base.set_state_dict(state)
        assert torch.equal(expert.act(), action)
        assert (action.unflatten(1, (-1, 3)).norm(dim=-1) <= 1.0 + 1e-6).all()


def test_expert_is_equivariant(make_folding):
    env = make_folding(4, resolution=49)
    base, expert = env.unwrapped, make_expert("ClothFolding-v1", env)
    rotation = torch.as_tensor(Rotation.random(random_state=1).as_matrix(), dtype=torch.float32)
    for _ in range(4):
        play(env, expert.act, num_steps=3)
        state, action = base.get_state_dict(), expert.act()
        base.move_worlds(rotation, torch.tensor([0.4, 0.1, -0.3]))
        turned = (action.unflatten(1, (-1, 3)) @ rotation.T).flatten(1)
        torch.testing.assert_close(expert.act(), turned, atol=1e-4, rtol=0)
        base.set_state_dict(state)
