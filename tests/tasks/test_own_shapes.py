"""Shapes of one's own, given to the tasks from outside the package."""

import json

import gymnasium as gym
import mani_skill.envs  # noqa: F401
import numpy as np
import pytest
import torch
from mani_skill.utils.wrappers import RecordEpisode

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.experts import make_expert
from maniskill_grpd.learning.options import parse_options
from maniskill_grpd.physics import square_outline
from maniskill_grpd.tasks import CLOTH_SHAPES, GOAL_SHAPES, goal_curve, register_cloth_shape, register_goal_shape

HOUSE = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.2, 0.45], [0.0, 0.3]])
STEP = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0]]


def make(env_id, num_envs=2, **options):
    env = gym.make(env_id, num_envs=num_envs, sim_backend="cpu", render_backend="none", obs_mode="none", **options)
    env.reset(seed=list(range(num_envs)))
    return env


@pytest.fixture
def own_shapes(monkeypatch):
    """An own outline and an own goal curve under names, as a user's module registers them."""
    for registry in (CLOTH_SHAPES, GOAL_SHAPES):
        monkeypatch.setattr(registry, "_shapes", dict(registry))  # they are forgotten after the test
    register_cloth_shape("house", HOUSE)
    register_goal_shape("step", STEP)


def test_own_outlines_hang_beside_named_ones(own_shapes):
    env = make("ClothHanging-v1", 16, shapes=["square", HOUSE, "house"], num_threads=1)
    masses = [model.masses.sum() for model in env.unwrapped.models]
    house_area = 0.4 * 0.3 + 0.5 * 0.4 * 0.15
    np.testing.assert_allclose(masses, 0.2 * (np.array([0.16, house_area, 0.16]) - np.pi * 0.06**2), rtol=0.02)
    assert set(env.unwrapped.solver.variants.tolist()) == {0, 1, 2}
    _, reward, *_ = env.step(env.action_space.sample())
    assert torch.isfinite(reward).all()
    env.close()


def test_the_hole_of_a_hanging_cloth_is_where_it_is_asked_for():
    env = make("ClothHanging-v1", 1, shapes=HOUSE, hole_center=(0.25, 0.12))
    loop = env.unwrapped.models[0].rest_positions[env.unwrapped.models[0].node_sets["hole_0"], :2]
    corner = env.unwrapped.models[0].rest_positions[:, :2].min(axis=0)
    np.testing.assert_allclose(loop.mean(axis=0) - corner, [0.25, 0.12], atol=1e-3)
    env.close()


ARROW_HEAD = [[0.0, 0.2], [-0.15, -0.1], [0.0, -0.03], [0.15, -0.1]]


@pytest.mark.parametrize("outline", [ARROW_HEAD, ARROW_HEAD[::-1]])
def test_an_arrow_head_is_folded_whichever_way_round_it_is_given(outline):
    """Clockwise outlines had no sides to fold in: an index error."""
    env = make("ClothFolding-v1", 8, shapes=outline, num_threads=1)
    expert = make_expert("ClothFolding-v1", env)
    for _ in range(40):
        *_, info = env.step(expert.act())
    assert info["success"].all()
    env.close()


def test_the_share_that_moves_leaves_out_the_holes():
    hole = square_outline(0.08) + [0.12, 0.19]
    env = make("ClothFolding-v1", 32, shapes=square_outline(0.24) + 0.12, holes=[hole], resolution=400, num_threads=1)
    task = env.unwrapped
    model = task.models[0]
    assert model.masses.sum() == pytest.approx(0.2 * (0.24**2 - 0.08**2), rel=0.01)
    np.testing.assert_allclose(model.rest_positions[model.node_sets["hole_0"], :2].mean(axis=0), [0.0, 0.07], atol=1e-3)
    share = (task.is_moving * torch.as_tensor(model.masses)).sum(1) / model.masses.sum()
    assert share.min() > 0.25 - 0.03  # a row of nodes
    assert share.max() < 0.5 + 0.03
    env.close()


def test_an_own_goal_curve_is_laid_on_the_table(own_shapes):
    for options in ({"goal_shape": STEP}, {"goal_shape": "step"}, {"shapes": [STEP]}):
        env = make("RopeShaping-v1", **options)
        goal = env.unwrapped.goal_positions[:, :, :2].double()
        curve = torch.as_tensor(goal_curve(STEP, 0.8, 41))
        torch.testing.assert_close(torch.cdist(goal, goal), torch.cdist(curve, curve).expand(2, -1, -1), atol=1e-5, rtol=0)
        env.close()


def test_the_command_line_takes_polygons_and_records_keep_plain_lists(tmp_path):
    text = json.dumps(HOUSE.tolist()).replace(" ", "")
    options = parse_options("env_kwargs", (f'shapes=[{text},"square"]',))
    assert options == {"shapes": [HOUSE.tolist(), "square"]}
    # An array, as a program gives it, becomes the same plain list in a recording.
    env = RecordEpisode(
        make("ClothHanging-v1", 1, shapes=[HOUSE, "square"]), str(tmp_path), save_video=False, trajectory_name="own"
    )
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.flush_trajectory()
    env.close()
    recorded = json.loads((tmp_path / "own.json").read_text())
    assert recorded["env_info"]["env_kwargs"]["shapes"] == options["shapes"]
    make("ClothHanging-v1", 1, **options).close()


@pytest.mark.parametrize(
    ("env_id", "options", "message"),
    [
        (
            "ClothHanging-v1",
            {"shapes": np.zeros((3, 5, 3))},
            r"shapes\[0\] must be a polygon .P >= 3, 2., got an array of shape .5, 3.",
        ),
        ("ClothFolding-v1", {"shapes": [[0.0, 0.0], [0.2, 0.2], [0.2, 0.0], [0.0, 0.3]]}, "must not intersect itself"),
        ("ClothFolding-v1", {"holes": [square_outline(0.3)]}, "hole 0 must lie inside the outline"),
        (
            "ClothFolding-v1",
            {"holes": square_outline(0.1)},
            r"holes\[0\] must be a polygon .P >= 3, 2., got an array of shape .2,.",
        ),
        ("ClothFolding-v1", {"shapes": ARROW_HEAD, "num_grippers": 1}, "polygon of 4 points needs two grippers"),
        ("ClothFolding-v1", {"shapes": [None]}, r"shapes\[0\] must be a polygon"),
        ("ClothHanging-v1", {"hanger": "bar", "hole_center": (0.0, 0.0)}, "over a bar has no hole.*hole_center"),
        ("ClothHanging-v1", {"hole_center": (0.3, 0.0)}, "hole_center must be"),
        ("RopeShaping-v1", {"goal_shape": np.zeros((4, 2))}, r"goal_shape\[0\] must be a curve"),
        ("RopeShaping-v1", {"shapes": np.array([])}, "goal shapes must be among W"),
    ],
)
def test_what_is_no_shape_is_refused_when_the_task_is_made(env_id, options, message):
    with pytest.raises(ValueError, match=message):
        make(env_id, **options)
