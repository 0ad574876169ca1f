"""Objects of several resolutions and materials in one environment."""

import pytest
import torch

from maniskill_grpd.tasks.observation.node_statistics import max_over_nodes, mean_over_nodes
from maniskill_grpd.tasks.options.material_ranges import MaterialRanges
from maniskill_grpd.tasks.options.resolutions import check_resolutions


def test_worlds_of_different_resolution_are_those_they_are_alone(make_env, draw_actions):
    mixed = make_env(6, resolution=[21, 41], shapes=("W", "V"), graph_nodes=None)
    base = mixed.unwrapped
    assert base.solver.variants.unique().tolist() == [0, 1]
    small = int((base.solver.variants == 0).nonzero()[0, 0])
    large = int((base.solver.variants == 1).nonzero()[0, 0])
    obs = mixed.step(torch.zeros(6, 12))[0]["graph"]["object"]
    assert obs["mask"].sum(1)[[small, large]].tolist() == [21, 41]
    assert (obs["neighbors"][small, 21:] == -1).all()
    base.graph_schema.validate(mixed.unwrapped.get_obs()["graph"], values=True)
    # the same world of 21 nodes in an environment that has no others
    single = make_env(1, resolution=21, shapes=("W", "V"))
    lone = single.unwrapped
    lone.goal_positions[0] = base.goal_positions[small, :21]
    held = base.start_nodes[small]
    assert held.tolist() == [0, 5, 15, 20]
    for env, world in ((base, small), (lone, 0)):
        index = torch.tensor([world])
        start = torch.zeros(1, env.solver.num_nodes, 3)
        start[0, :21, 0] = torch.linspace(-0.4, 0.4, 21)
        start[..., 2] = 0.01
        env.solver.reset(index, start, held)
        for agent in env._agents:
            agent.robot.place(index)
    for action in draw_actions(5, 1):
        everywhere = torch.zeros(6, 12)
        everywhere[small] = action[0]
        reward = mixed.step(everywhere)[1][small]
        expected = single.step(action)[1][0]
        assert torch.equal(base.solver.positions[small, :21], lone.solver.positions[0])
        torch.testing.assert_close(reward, expected)


def test_episodes_draw_resolutions_from_their_own_seed(make_env):
    env, other = make_env(4, resolution=[21, 41]), make_env(2, resolution=[21, 41])
    env.reset(seed=[1, 2, 3, 4]), other.reset(seed=[3, 4])
    assert torch.equal(env.unwrapped.solver.variants[2:], other.unwrapped.solver.variants)
    state = env.unwrapped.get_state()
    env.reset(seed=[11, 12, 13, 14])
    env.unwrapped.set_state(state)
    assert torch.equal(env.unwrapped.get_state(), state)


def test_materials_are_drawn_per_episode_and_are_part_of_the_state(make_env):
    ranges = {"mass": (0.5, 2.0), "friction": 1.5}
    env = make_env(64, material=ranges)
    solver, plain = env.unwrapped.solver, make_env(64).unwrapped.solver
    factors = plain.inverse_masses[:, 0] / solver.inverse_masses[:, 0]
    assert 0.5 <= factors.min() < 0.8
    assert 1.5 < factors.max() <= 2.0 * (1 + 1e-5)
    torch.testing.assert_close(solver.friction, 1.5 * plain.friction)
    assert torch.equal(solver.positions, plain.positions)  # materials come after the poses
    state = env.unwrapped.get_state()
    env.reset(seed=3)
    env.unwrapped.set_state(state)
    torch.testing.assert_close(plain.inverse_masses[:, 0] / solver.inverse_masses[:, 0], factors)


def test_factors_are_uniform_in_their_logarithm():
    ranges = MaterialRanges({"bend": (0.25, 4.0), "stretch": 2.0})
    factors = ranges.factors(torch.tensor([[-1.0, 0.3], [0.0, 0.3], [1.0, 0.3]]))
    torch.testing.assert_close(factors["bend"], torch.tensor([0.25, 1.0, 4.0]))
    torch.testing.assert_close(factors["stretch"], torch.full((3,), 2.0))


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"colour": 1.0}, "material must name some of"),
        ({"mass": (2.0, 1.0)}, r"material\['mass'\] must be"),
        ({"mass": 0.0}, "must be a factor > 0"),
        ({"mass": (1.0, float("inf"))}, "must be a factor > 0"),
        ({"mass": (1.0, 2.0, 3.0)}, "pair"),
    ],
)
def test_impossible_materials_are_refused(ranges, message):
    with pytest.raises(ValueError, match=message):
        MaterialRanges(ranges)


def test_statistics_leave_the_padding_out():
    values = torch.tensor([[1.0, 3.0, 9.0], [2.0, 0.0, 4.0]])
    mask = torch.tensor([[True, True, False], [False, False, False]])
    assert mean_over_nodes(values, mask).tolist() == [2.0, 0.0]
    assert max_over_nodes(values, mask).tolist() == [3.0, 0.0]


@pytest.mark.parametrize("value", [19, 201, [41, 19], [], 40.5, True])
def test_impossible_resolutions_are_refused(value):
    with pytest.raises(ValueError, match=r"\[20, 200\]"):
        check_resolutions(value, 20, 200)


def test_substeps_are_those_of_the_variant_or_of_the_option(make_env):
    assert make_env(1, resolution=(21, 81)).unwrapped.solver.substeps == (20, 40)
    assert make_env(1, resolution=(21, 81), substeps=30).unwrapped.solver.substeps == (30, 30)


@pytest.mark.parametrize("substeps", [0, 1001, 2.5, True])
def test_substeps_out_of_range_are_refused(make_env, substeps):
    with pytest.raises(ValueError, match=r"substeps must be a whole number in \[1, 1000\], got"):
        make_env(1, substeps=substeps)


def test_grippers_of_finite_strength_lose_the_rope_and_info_counts_it(make_env):
    env = make_env(2, grip_strength=0.02)
    assert "slips" not in make_env(1).unwrapped.get_info()
    up = torch.zeros(2, 4, 3)
    up[0, :, 2] = 1.0
    for _ in range(4):
        info = env.step(up.flatten(1))[-1]
    assert (info["slips"][0] == 1).all()
    assert (info["slips"][1] == 0).all()
    assert env.unwrapped.solver.gripper_nodes[0].tolist() == [-1] * 4
    env.reset()
    assert (env.unwrapped.solver.slips == 0).all()


def test_a_gripper_without_strength_is_refused(make_env):
    with pytest.raises(ValueError, match="grip_strength must be finite and > 0 N, or None for unlimited, got 0"):
        make_env(1, grip_strength=0)
