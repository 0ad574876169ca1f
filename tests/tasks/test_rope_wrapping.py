"""RopeWrapping-v1 keeps what its task card promises."""

import math

import numpy as np
import pytest
import torch
import trimesh
from post_scenes import ALL_SHAPES, arms, normalized, post_base, ring, rotation_of, straight_on

from maniskill_grpd.tasks import RopeWrappingEnv
from maniskill_grpd.tasks.geometry.posts import POST_HEIGHT, POSTS

ENV_ID = "RopeWrapping-v1"
VOLUMES = {"cylinder": math.pi * 0.06**2, "box": 0.1**2, "prism": 0.75 * 3**0.5 * 0.08**2}


def start_poses(base):
    """Return what an episode draws, recovered from the state: (B, 6), in the order of `bounds`."""
    rope, post = base.solver.positions[..., :2], post_base(base)[:, 0, :2]
    w, _, _, z = base.solver.collider_rotations[:, 0].unbind(1)
    chord = torch.nn.functional.normalize(rope[:, -1] - rope[:, 0], dim=-1)
    offset = 0.5 * (rope[:, 0] + rope[:, -1]) - post
    aside = chord[:, 0] * offset[:, 1] - chord[:, 1] * offset[:, 0]
    yaws = [2.0 * torch.atan2(z, w), torch.atan2(chord[:, 1], chord[:, 0])]
    return torch.stack([*post.T, *yaws, aside, (offset * chord).sum(-1)], dim=1)


@pytest.mark.parametrize(("pose_range", "share", "rounds"), [("full", 1.0, 10), ("half", 0.5, 1), ("quarter", 0.25, 1)])
def test_starts_fill_the_ranges_of_the_task_card_and_are_sound(make_env, pose_range, share, rounds):
    env = make_env(1000, pose_range=pose_range, shapes=ALL_SHAPES, obs_mode="none")
    base = env.unwrapped
    bounds = share * torch.tensor([0.15, 0.15, math.pi, math.pi, 0.2, 0.15]) + torch.tensor([0.0, 0, 0, 0, 0.1, 0])
    poses = []
    for _ in range(rounds):
        env.reset()
        poses.append(start_poses(base))
        edges = base.solver.positions.diff(dim=1).norm(dim=-1)
        torch.testing.assert_close(edges, torch.full_like(edges, 0.02), atol=1e-6, rtol=0)
        assert torch.equal(base.solver.positions[..., 2], torch.full((1000, 41), base.solver.model.radius))
        assert not base.evaluate()["success"].any()
    poses = torch.cat(poses)
    assert (poses.abs().amax(dim=0) <= bounds * (1 + 1e-4)).all()
    assert (poses.amax(dim=0) > 0.98 * bounds).all()
    assert (poses.amin(dim=0) < -0.98 * bounds).all()
    # The rope's line passes at 0.1 m or more, and no post with the rope's radius around it reaches as far.
    assert poses[:, 4].abs().min() >= 0.1 * (1 - 1e-4)
    assert poses[:, 4].abs().min() < 0.1 + 0.02 * share * 0.2
    assert max(post.circumradius for post in POSTS.values()) + base.solver.model.radius < 0.1
    columns = torch.cat([poses, poses[:, 4:5].abs()], dim=1)  # 4.5 sigma
    correlation = np.corrcoef(columns.T.numpy())[np.triu_indices(7, 1)]
    assert np.abs(correlation).max() < 4.5 / (1000 * rounds) ** 0.5
    assert (poses.mean(dim=0) / bounds).abs().max() < 4.5 / (1000 * rounds) ** 0.5


def test_task_card_states_the_ranges_and_limits():
    card = RopeWrappingEnv.__doc__
    headings = ["Task Description", "Randomizations", "Success Conditions", "Fail Conditions", "Goal Specification"]
    places = [card.index(f"**{heading}:**") for heading in headings]
    assert places == sorted(places)
    for fact in ("[-0.15, 0.15] m x [-0.15, 0.15] m", "[-180, 180] degrees", "uniform in [0.1, 0.3] m", "0.15 m height"):
        assert fact in card
    assert f"at least {RopeWrappingEnv.WINDING_LIMIT}" in card
    assert f"at most {RopeWrappingEnv.ENDS_LIMIT} m apart" in card


def test_each_episode_draws_one_of_several_posts(make_env):
    env = make_env(300, shapes=ALL_SHAPES, obs_mode="none")
    active = env.unwrapped.solver.collider_active
    assert (active.sum(dim=1) == 1).all()
    # 300 draws of one in three: 100 +- 4.5 sigma
    assert (active.sum(dim=0) - 100).abs().max() < 37
    graph = make_env(6, shapes=ALL_SHAPES).unwrapped.get_obs()["graph"]
    names = [channel.name for channel in env.unwrapped.graph_schema.object.scalars]
    one_hot = graph["object"]["scalars"][:, :, [names.index(f"post_is_{shape}") for shape in ALL_SHAPES]]
    assert torch.equal(one_hot, active[:6, None].float().expand(6, 41, 3)), "the same seeds draw the same posts"


# ---------------------------------------------------------------------- success


def closed_but_not_around():
    """Return a ring that is dented so far that the post is outside."""
    points = ring(radius=0.2, centre=(0.1, 0.0))
    points[20 - 3 : 20 + 4, 0] = 0.25
    return points


def with_a_loop_over_the_top():
    points = ring()
    points[10:14, 2] = POST_HEIGHT + 0.005
    return points


CONFIGURATIONS = {
    "closed ring": (ring, True),
    "the other way around": (lambda: ring(turns=-1.0), True),
    "not quite closed": (lambda: ring(turns=0.951), True),  # ends 3.7 cm apart
    "too little around": (lambda: ring(radius=0.09, turns=0.949), False),  # ends 2.9 cm apart
    "crossed ends": (lambda: ring(turns=1.05), True),
    "ends too far apart": (lambda: ring(turns=1.08), False),  # 6 cm
    "twice around": (lambda: ring(turns=2.0), True),
    "at the top of the post": (lambda: ring(height=0.149), True),
    "above the post": (lambda: ring(height=0.151), False),
    "part of it above the post": (with_a_loop_over_the_top, False),
    "beside the post": (lambda: ring(centre=(0.2, 0.0)), False),
    "dented away from the post": (closed_but_not_around, False),
    "half around and back": (lambda: torch.cat([ring(turns=0.6)[::2], ring(turns=0.6)[1::2].flip(0)]), False),
}


def test_success_is_a_rope_that_is_closed_around_the_post_at_its_height(make_env):
    env = make_env(len(CONFIGURATIONS), shapes=ALL_SHAPES)
    base = env.unwrapped
    shapes = torch.stack([build() for build, _ in CONFIGURATIONS.values()])
    base.solver.positions.copy_(shapes + post_base(base))
    success = base.evaluate()["success"].tolist()
    assert dict(zip(CONFIGURATIONS, success, strict=True)) == {name: good for name, (_, good) in CONFIGURATIONS.items()}


def test_success_is_the_same_in_every_frame(make_env):
    """Limits that are measured along an axis of the world hold on a table that lies flat, and nowhere else."""
    env = make_env(len(CONFIGURATIONS), shapes=ALL_SHAPES)
    base = env.unwrapped
    base.solver.positions.copy_(torch.stack([build() for build, _ in CONFIGURATIONS.values()]) + post_base(base))
    state, expected = base.get_state_dict(), [good for _, good in CONFIGURATIONS.values()]
    for seed in range(10):
        base.set_state_dict(state)
        base.move_worlds(rotation_of(seed), torch.tensor([0.2, -0.1, 0.3]))
        assert base.evaluate()["success"].tolist() == expected


def test_a_frozen_world_has_failed(make_env):
    env = make_env(2)
    base = env.unwrapped
    base.solver.positions.copy_(ring() + post_base(base))
    base.solver.frozen[0] = True
    info = base.get_info()
    assert info["success"].tolist() == [False, True]
    assert info["fail"].tolist() == [True, False]
    assert base.get_reward(None, None, info).tolist() == [0.0, pytest.approx(1.0, abs=1e-5)]


def test_padding_does_not_count(make_env):
    base = make_env(16, resolution=(20, 41), obs_mode="none").unwrapped
    base.solver.variants.copy_(torch.arange(16) % 2)
    base.solver.node_mask[:, 20:] = (base.solver.variants == 1)[:, None]
    points = torch.full((16, 41, 3), 7.0)
    points[::2, :20], points[1::2] = ring(num_nodes=20), ring()
    base.solver.positions.copy_(points + post_base(base))
    info = base.evaluate()
    assert info["success"].all()
    assert (info["share_at_height"] == 1.0).all()


# ---------------------------------------------------------------------- reward


def test_reward_is_the_formula_of_its_constants(make_env):
    env = make_env(8)
    generator = torch.Generator().manual_seed(0)
    for _ in range(10):
        _, reward, _, _, info = env.step(torch.randn(8, 6, generator=generator))
    base = env.unwrapped
    winding = info["winding"].clamp(max=1.0) * info["share_at_height"]
    closing = winding**2 * (1 - torch.tanh(info["ends_distance"] / base.CLOSING_SCALE))
    weights = [base.WINDING_WEIGHT, base.CLOSING_WEIGHT, base.SUCCESS_WEIGHT]
    expected = weights[0] * winding + weights[1] * closing + weights[2] * info["success"]
    torch.testing.assert_close(reward, expected)
    assert sum(weights) == pytest.approx(1.0)
    torch.testing.assert_close(base.compute_normalized_dense_reward(None, None, info), reward)


def test_reward_rises_while_a_rope_closes_around_the_post_and_not_beside_it(make_env):
    base = make_env(40).unwrapped
    turns = torch.linspace(0.2, 1.0, 40)
    rewards = {}
    for name, centre in {"around": 0.0, "beside": 0.3}.items():
        arcs = [ring(radius=0.127, turns=share.item(), centre=(centre, 0.0)) for share in turns]
        base.solver.positions.copy_(torch.stack(arcs) + post_base(base))
        rewards[name] = base.get_reward(None, None, base.get_info())
    assert (rewards["around"].diff() > 0.0).all()
    assert rewards["around"][-1] > 0.99
    assert rewards["beside"].max() < 0.05


def play(env, choose, num_steps=100):
    """Play one episode; return the mean reward per step of every world (B,) and the last info."""
    total = 0.0
    for step in range(num_steps):
        _, reward, _, _, info = env.step(choose(step))
        assert ((reward >= 0.0) & (reward <= 1.0)).all()
        total = total + reward
    return total / num_steps, info


def simple_policies(base, generator):
    """Return policies that do not solve the task, by name: functions of the step to actions."""

    def grippers():
        return arms(base, base.solver.gripper_positions)

    num, up = base.num_envs, base.post_rotation[:, None, :, 2].expand(-1, 2, -1)
    constant = torch.randn(num, 6, generator=generator)
    forward = straight_on(base)
    return {
        "stand still": lambda step: torch.zeros(num, 6),
        "random": lambda step: torch.randn(num, 6, generator=generator),
        "constant": lambda step: constant,
        "push straight on": lambda step: forward,
        "circle": lambda step: normalized(torch.linalg.cross(up, grippers())).flatten(1),
        "together": lambda step: (base.solver.gripper_positions.flip(1) - base.solver.gripper_positions).flatten(1) / 0.06,
        "to the post": lambda step: normalized(-grippers()).flatten(1),
        "lift": lambda step: up.flatten(1),
    }


def test_simple_policies_earn_less_than_a_third(make_env):
    env = make_env(12, shapes=ALL_SHAPES, obs_mode="none")
    generator = torch.Generator().manual_seed(0)
    for name in simple_policies(env.unwrapped, generator):
        env.reset(seed=list(range(12)))
        reward, info = play(env, simple_policies(env.unwrapped, generator)[name])
        assert reward.max() < 0.33, name
        assert not info["success"].any(), name


# ---------------------------------------------------------------------- options and pictures


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"shapes": "cone"}, r"among cylinder, box, prism, got \['cone'\]"),
        ({"shapes": ()}, r"among cylinder, box, prism, got \[\]"),
        ({"shapes": ("box", "box")}, "must be different ones"),
        ({"resolution": 19}, r"in \[20, 200\] nodes, got 19"),
        ({"num_grippers": 3}, r"must be one of \[2\], got 3"),
    ],
)
def test_options_that_are_not_allowed_are_refused(make_env, options, message):
    with pytest.raises(ValueError, match=message):
        make_env(1, **options)


def test_grippers_hold_the_ends_at_every_resolution(make_env):
    base = make_env(8, resolution=(20, 60), obs_mode="none").unwrapped
    last = torch.tensor([19, 59])[base.solver.variants.long()]
    assert torch.equal(base.start_nodes, torch.stack([torch.zeros_like(last), last], dim=1))
    assert len(base.solver.variants.unique()) == 2


def test_flat_observations_tell_the_pose_and_the_shape_of_the_post(make_env):
    env = make_env(6, shapes=("prism", "box"), obs_mode="state_dict")
    extra, solver = env.unwrapped.get_obs()["extra"], env.unwrapped.solver
    assert torch.equal(extra["post_pose"], torch.cat([solver.collider_positions[:, 0], solver.collider_rotations[:, 0]], dim=1))
    assert torch.equal(extra["post_shape"], torch.eye(3)[[2, 1]][solver.collider_active.long().argmax(dim=1)])


@pytest.mark.parametrize("shape", ALL_SHAPES)
def test_posts_are_drawn_as_the_solids_that_the_rope_touches(make_env, shape):
    base = make_env(2, shapes=shape).unwrapped
    base.move_worlds(rotation_of(1), torch.tensor([0.2, 0.1, -0.4]))
    solid = base.drawing(1).solids[0]
    mesh = trimesh.Trimesh(solid.vertices, solid.faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(VOLUMES[shape] * POST_HEIGHT, rel=0.01)  # positive: faces look outward
    np.testing.assert_allclose(mesh.center_mass, base.solver.collider_positions[1, 0], atol=1e-5)
    vertices = torch.as_tensor(solid.vertices, dtype=torch.float32).expand(2, -1, 3)
    heights = base.in_post_frame(vertices, base.post_rotation)[1, :, 2]
    np.testing.assert_allclose([heights.min(), heights.max()], [0.0, POST_HEIGHT], atol=1e-6)
