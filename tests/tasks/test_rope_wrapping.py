"""RopeWrapping-v1 keeps what its task card promises."""

import gc
import math

import gymnasium as gym
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

import maniskill_grpd  # noqa: F401  (registers)
from maniskill_grpd.tasks import RopeWrappingEnv
from maniskill_grpd.tasks.posts import POST_HEIGHT, POSTS

ALL_SHAPES = ("cylinder", "box", "prism")
VOLUMES = {"cylinder": math.pi * 0.06**2, "box": 0.1**2, "prism": 0.75 * 3**0.5 * 0.08**2}
INRADII = {"cylinder": 0.06, "box": 0.05, "prism": 0.04}


@pytest.fixture
def make_env(monkeypatch):
    """Return a function that makes RopeWrapping-v1 on the CPU, reset with seed 0."""
    monkeypatch.setattr(gc, "collect", lambda: 0)  # ManiSkill's collections are most of the tests' time
    made = []

    def make(num_envs=3, **options):
        settings = {"sim_backend": "cpu", "render_backend": "none", **options}
        made.append(gym.make("RopeWrapping-v1", num_envs=num_envs, **settings))
        made[-1].reset(seed=0)
        return made[-1]

    yield make
    for env in made:
        env.close()


def post_base(base):
    """Return the middle of the base of each post, (B, 1, 3)."""
    return (base.solver.collider_positions[:, 0] - POST_HEIGHT / 2 * base.post_rotation[:, :, 2])[:, None]


def arms(base, points):
    """Return the vectors from the axis of each post to points (B, n, 3)."""
    offsets, axis = points - post_base(base), base.post_rotation[:, None, :, 2]
    return offsets - (offsets * axis).sum(-1, keepdim=True) * axis


def winding(base):
    return base.signed_winding(base.post_rotation)


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


def ring(*, radius=0.12, turns=1.0, height=0.01, centre=(0.0, 0.0), num_nodes=41):
    """Return a rope on an arc about a post, relative to the middle of its base, (N, 3)."""
    angle = 2 * math.pi * turns * torch.linspace(0.0, 1.0, num_nodes)
    return torch.stack(
        [radius * angle.cos() + centre[0], radius * angle.sin() + centre[1], torch.full((num_nodes,), height)], dim=-1
    )


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


def normalized(vectors):
    return torch.nn.functional.normalize(vectors, dim=-1)


def simple_policies(base, generator):
    """Return policies that do not solve the task, by name: functions of the step to actions."""

    def grippers():
        return arms(base, base.solver.gripper_positions)

    num, up = base.num_envs, base.post_rotation[:, None, :, 2].expand(-1, 2, -1)
    constant = torch.randn(num, 6, generator=generator)
    forward = normalized(-arms(base, base.solver.positions).mean(dim=1)).repeat(1, 2)
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


# ---------------------------------------------------------------------- contact


@pytest.mark.parametrize("shape", ALL_SHAPES)
def test_a_rope_pulled_against_the_post_stays_on_its_side_and_keeps_its_length(make_env, shape):
    """Straight on at full speed for a whole episode: the way around the post is longer than the grippers are apart."""
    env = make_env(24, shapes=shape, obs_mode="none")
    base = env.unwrapped
    push = simple_policies(base, None)["push straight on"]
    start = winding(base)
    for step in range(100):
        env.step(push(step))
        edges = base.solver.positions.diff(dim=1).norm(dim=-1)
        assert edges.sum(dim=1).max() < 0.8 * 1.03
        assert arms(base, base.solver.positions).norm(dim=-1).min() > INRADII[shape] + 0.8 * base.solver.model.radius
        assert (winding(base) * start.sign() > start.abs() - 0.05).all()
    assert (winding(base).abs() > 0.6).all()


def test_winding_up_stops_when_the_rope_is_used_up(make_env):
    """Ends that circle against each other: about 0.8 m / (2 pi 0.07 m) turns are there."""
    env = make_env(12, obs_mode="none")
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
    spirals = torch.stack([ring(radius=0.08, turns=1.8, height=height) for height in (0.01, 0.2)])
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


def rotation_of(seed):
    return torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)


@pytest.fixture
def half_wrapped_env(make_env):
    """Worlds in motion, in one of them with the rope closed around the post."""
    env = make_env(4, shapes=ALL_SHAPES)
    base = env.unwrapped
    push = simple_policies(base, None)["push straight on"]
    for step in range(8):
        env.step(push(step))
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
    push = simple_policies(base, None)["push straight on"](0)
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
    push = simple_policies(many.unwrapped, None)["push straight on"](0)
    for _ in range(30):
        many.step(push)
        few.step(push[5:8])
    here, there = many.unwrapped.solver, few.unwrapped.solver
    assert torch.equal(here.gripper_positions[5:8], there.gripper_positions)
    assert torch.equal(here.positions[5:8], there.positions)


def test_resets_of_some_worlds_leave_the_others_alone(make_env):
    env, untouched = make_env(5, shapes=ALL_SHAPES), make_env(5, shapes=ALL_SHAPES)
    push = simple_policies(env.unwrapped, None)["push straight on"](0)
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
    solid = base._drawing(1).solids[0]
    mesh = trimesh.Trimesh(solid.vertices, solid.faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(VOLUMES[shape] * POST_HEIGHT, rel=0.01)  # positive: faces look outward
    np.testing.assert_allclose(mesh.center_mass, base.solver.collider_positions[1, 0], atol=1e-5)
    vertices = torch.as_tensor(solid.vertices, dtype=torch.float32).expand(2, -1, 3)
    heights = base.in_post_frame(vertices, base.post_rotation)[1, :, 2]
    np.testing.assert_allclose([heights.min(), heights.max()], [0.0, POST_HEIGHT], atol=1e-6)
