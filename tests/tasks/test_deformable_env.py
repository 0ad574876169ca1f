"""The bridge to ManiSkill: spaces, observations, seeds, resets and states of a batch of worlds."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils import common
from mani_skill.utils.registration import REGISTERED_ENVS


def leaves(tree, path=""):
    """Yield (path, tensor) of a nested dictionary."""
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}/{key}")
        else:
            yield f"{path}/{key}", value


def assert_equal(tree, other, rows=slice(None), other_rows=slice(None)):
    """Assert that two nested dictionaries are bitwise equal, in given rows."""
    other = dict(leaves(other))
    for path, value in leaves(tree):
        assert torch.equal(value[rows], other[path][other_rows]), path


def run(env, actions):
    """Return the graphs, rewards and infos after each of several actions."""
    history = []
    for action in actions:
        obs, reward, _, _, info = env.step(action)
        history.append({"obs": obs, "reward": reward, "info": info})
    return history


# ---------------------------------------------------------------- spaces and observations


def test_is_registered():
    assert REGISTERED_ENVS["RopeShaping-v1"].max_episode_steps == 100
    env = gym.make("maniskill_grpd:RopeShaping-v1", render_backend="none", sim_backend="cpu")
    assert env.spec.id == "RopeShaping-v1"
    env.close()


def test_graph_fits_its_schema_and_the_worlds(make_env, draw_actions):
    env = make_env(obs_mode="graph", graph_nodes=None, graph_features="rich")
    base = env.unwrapped
    obs = run(env, draw_actions(5, 3))[-1]["obs"]
    graph, solver = obs["graph"], base.solver
    base.graph_schema.validate(graph, values=True)
    vectors = [channel.name for channel in base.graph_schema.object.vectors]
    scalars = [channel.name for channel in base.graph_schema.object.scalars]
    assert (vectors, scalars) == (["velocity", "goal_offset"], ["goal_distance", "arc", "held", "contact"])
    nodes, grippers = graph["object"], graph["actuator"]
    offsets = base.goal_positions - solver.positions
    assert torch.equal(nodes["position"], solver.positions)
    assert torch.equal(nodes["vectors"], torch.stack([solver.velocities, offsets], dim=2))
    assert torch.equal(nodes["scalars"][..., 0], offsets.norm(dim=-1))
    torch.testing.assert_close(nodes["scalars"][0, :, 1], torch.linspace(-1, 1, 41).abs())
    assert nodes["scalars"][0, :, 2].nonzero()[:, 0].tolist() == [0, 10, 30, 40]
    is_low = solver.positions[..., 2] < 1.5 * base.solver.model.radius
    assert torch.equal(nodes["scalars"][..., 3], is_low.float())
    assert 0 < is_low.float().mean() < 1
    assert nodes["neighbors"][1, :3].tolist() == [[1, -1], [0, 2], [1, 3]]
    held = [0, 10, 30, 40]
    torch.testing.assert_close(grippers["position"], nodes["position"][:, held], atol=1e-6, rtol=0)
    assert torch.equal(grippers["vectors"][:, :, 0].flatten(1), base.agent.robot.qvel)
    assert torch.equal(grippers["vectors"][:, :, 1], offsets[:, held])
    assert torch.equal(grippers["scalars"][..., 0], offsets[:, held].norm(dim=-1))
    assert grippers["scalars"][0, :, 1:].tolist() == [[1, 1], [0.5, 1], [0.5, 1], [1, 1]]
    assert graph["gravity"].tolist() == [[0, 0, pytest.approx(-9.81)]] * 3


def test_graph_nodes_thins_what_the_policy_sees_but_not_the_simulation(make_env, draw_actions):
    full, thin = make_env(resolution=60, graph_nodes=None), make_env(resolution=60, graph_nodes=12)
    for env in (full, thin):
        env.reset(seed=3)
    actions = draw_actions(4, 3)
    seen, all_seen = run(thin, actions)[-1], run(full, actions)[-1]
    graph = seen["obs"]["graph"]
    thin.unwrapped.graph_schema.validate(graph, values=True)
    assert graph["object"]["position"].shape == (3, 12, 3)
    assert thin.unwrapped.graph_schema.edge_length == pytest.approx(0.8 / 11)
    assert full.unwrapped.graph_schema.edge_length == pytest.approx(0.8 / 59)
    assert_equal(thin.unwrapped.get_state_dict(), full.unwrapped.get_state_dict())
    assert torch.equal(seen["reward"], all_seen["reward"])
    nodes, all_nodes = graph["object"]["position"], all_seen["obs"]["graph"]["object"]["position"]
    is_same = (nodes[:, :, None] == all_nodes[:, None]).all(dim=-1)  # (B, 12, 60)
    assert is_same.any(dim=2).all()
    assert (graph["object"]["scalars"][..., 2].sum(dim=1) == 4).all()


@pytest.mark.parametrize("obs_mode", ["graph", "state", "state_dict+graph"])
def test_observations_infos_and_states_are_copies(make_env, draw_actions, obs_mode):
    env = make_env(obs_mode=obs_mode)
    obs, info = env.reset(seed=0)
    kept = {"obs": obs, "info": {k: v for k, v in info.items() if k != "reconfigure"}, "state": env.unwrapped.get_state_dict()}
    before = {path: value.clone() for path, value in leaves(kept)}
    run(env, draw_actions(2, 3))
    env.reset(seed=5)
    for path, value in leaves(kept):
        assert torch.equal(value, before[path]), path


def test_damaging_an_observation_does_not_damage_the_worlds(make_env, draw_actions):
    env, other = make_env(), make_env()
    for each in (env, other):
        each.reset(seed=0)
    for action in draw_actions(2, 3):
        obs, _, _, _, info = env.step(action)
        for _, value in [*leaves(obs), *leaves(info)]:
            value.zero_()
        last = other.step(action)
    assert_equal(env.unwrapped.get_state_dict(), other.unwrapped.get_state_dict())
    assert_equal(env.unwrapped.get_obs(), last[0])


# ---------------------------------------------------------------- seeds and resets


def test_one_number_seeds_all_worlds_reproducibly(make_env):
    env, other = make_env(), make_env()
    obs, _ = env.reset(seed=4)
    again, _ = other.reset(seed=4)
    assert_equal(obs, again)
    goals = obs["graph"]["object"]["vectors"][:, :, 1]
    assert (goals[0] != goals[1]).any()
    different, _ = env.reset(seed=5)
    assert (different["graph"]["object"]["position"] != obs["graph"]["object"]["position"]).any()


def test_seeding_some_worlds_leaves_the_next_episodes_of_the_others_unchanged(make_env):
    env, control, single = make_env(), make_env(), make_env(1)
    env.reset(seed=[1, 2, 3])
    control.reset(seed=[1, 2, 3])
    obs, _ = env.reset(seed=[77], options={"env_idx": torch.tensor([1])})
    assert_equal(obs, single.reset(seed=77)[0], [1], [0])
    assert env.unwrapped._episode_seed.tolist() == [1, 77, 3]
    assert_equal(env.reset()[0], control.reset()[0], [0, 2], [0, 2])


def test_seeding_some_worlds_also_decides_their_later_episodes(make_env):
    """The generator that draws the seeds of later episodes is seeded too, not that of the first episode alone."""
    env, single = make_env(enhanced_determinism=True), make_env(1, enhanced_determinism=True)
    env.reset(seed=[1, 2, 3])
    env.reset(seed=[77], options={"env_idx": torch.tensor([1])})
    single.reset(seed=77)
    assert_equal(env.reset()[0], single.reset()[0], [1], [0])


def test_resetting_no_world_changes_nothing(make_env, draw_actions):
    env, control = make_env(enhanced_determinism=True), make_env(enhanced_determinism=True)
    for each in (env, control):
        each.reset(seed=3)
    obs = run(env, draw_actions(2, 3))[-1]["obs"]
    run(control, draw_actions(2, 3))
    for nobody in (torch.tensor([], dtype=torch.int64), torch.zeros(3, dtype=torch.bool), np.array([], dtype=int), []):
        for seed in (None, [], 5):
            now, info = env.reset(seed=seed, options={"env_idx": nobody})
            assert_equal(now, obs)
            assert info["elapsed_steps"].tolist() == [2, 2, 2]
            assert not info["reconfigure"]
    assert_equal(env.unwrapped.get_state_dict(), control.unwrapped.get_state_dict())
    assert_equal(env.reset()[0], control.reset()[0])


def test_worlds_to_reset_may_be_given_as_a_mask(make_env):
    env, other = make_env(), make_env()
    mask = torch.tensor([True, False, True])
    obs, _ = env.reset(seed=[5, 6], options={"env_idx": mask})
    assert_equal(obs, other.reset(seed=[5, 6], options={"env_idx": torch.tensor([0, 2])})[0])
    assert env.unwrapped._episode_seed[[0, 2]].tolist() == [5, 6]
    with pytest.raises(ValueError, match="expected 1 or 2 seeds.*got 3"):
        env.reset(seed=[5, 6, 7], options={"env_idx": mask})


@pytest.mark.parametrize("env_idx", [[3], [-1], [0.5], [True, False], [[0, 1]]])
def test_worlds_that_do_not_exist_are_refused(make_env, env_idx):
    env = make_env()
    before = env.unwrapped.get_state_dict()
    with pytest.raises(ValueError, match=r"env_idx must be indices in \[0, 3\) or a mask \(3,\)"):
        env.reset(options={"env_idx": torch.tensor(env_idx)})
    with pytest.raises(ValueError, match=r"env_idx must be indices in \[0, 3\) or a mask \(3,\)"):
        env.unwrapped.set_state_dict(before, torch.tensor(env_idx))
    assert_equal(env.unwrapped.get_state_dict(), before)


def test_seeds_that_fit_no_world_are_refused(make_env):
    env = make_env()
    with pytest.raises(ValueError, match="expected 1 or 3 seeds.*got 2"):
        env.reset(seed=[1, 2])
    with pytest.raises(ValueError, match="expected 1 or 2 seeds.*got 3"):
        env.reset(seed=[1, 2, 3], options={"env_idx": torch.tensor([0, 1])})


def test_enhanced_determinism_makes_unseeded_episodes_replayable(make_env):
    env = make_env(enhanced_determinism=True)
    env.reset(seed=0)
    obs, _ = env.reset()
    seeds = env.unwrapped._episode_seed.tolist()
    assert_equal(env.reset(seed=seeds)[0], obs)


def test_reconfiguring_rebuilds_the_same_worlds(make_env, draw_actions):
    env = make_env()
    obs, _ = env.reset(seed=0)
    again, info = env.reset(seed=0, options={"reconfigure": True})
    assert info["reconfigure"]
    assert_equal(again, obs)
    run(env, draw_actions(1, 3))


# ---------------------------------------------------------------- states


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("numpy", [False, True])
def test_restored_states_continue_bitwise(make_env, draw_actions, flat, numpy):
    env = make_env(obs_mode="state_dict+graph")
    base = env.unwrapped
    run(env, draw_actions(3, 3))
    state = base.get_state() if flat else base.get_state_dict()
    saved = common.to_numpy(state) if numpy else state
    obs = base.get_obs()
    actions = draw_actions(4, 3, seed=1)
    first = run(env, actions)
    env.reset(seed=99)
    (base.set_state if flat else base.set_state_dict)(saved)
    assert_equal(base.get_obs(), obs)
    for one, other in zip(first, run(env, actions), strict=True):
        assert_equal(one["obs"], other["obs"])
        assert torch.equal(one["reward"], other["reward"])


def test_some_worlds_can_be_restored_in_any_order(make_env, draw_actions):
    env = make_env(4)
    base = env.unwrapped
    run(env, draw_actions(3, 4))
    saved = base.get_state_dict()
    run(env, draw_actions(3, 4, seed=1))
    current = base.get_state_dict()
    worlds = torch.tensor([3, 1])
    base.set_state_dict(common.index_dict_array(saved, worlds, inplace=False), worlds)
    assert_equal(base.get_state_dict(), saved, [1, 3], [1, 3])
    assert_equal(base.get_state_dict(), current, [0, 2], [0, 2])
    # states move between worlds and between batches
    base.set_state(base.get_state()[[1]], env_idx=[0])
    assert_equal(base.get_state_dict(), saved, [0], [1])


@pytest.mark.parametrize("flat", [False, True])
def test_a_single_world_accepts_an_unbatched_state(make_env, draw_actions, flat):
    env = make_env(1)
    base = env.unwrapped
    run(env, draw_actions(2, 1))
    state = base.get_state() if flat else base.get_state_dict()
    env.reset(seed=3)
    row = state[0].numpy() if flat else common.to_numpy(common.index_dict_array(state, 0, inplace=False))
    (base.set_state if flat else base.set_state_dict)(row)
    restored = base.get_state() if flat else base.get_state_dict()
    assert torch.equal(restored, state) if flat else assert_equal(restored, state) is None


def test_worlds_can_be_reset_to_states(make_env, draw_actions):
    env = make_env()
    base = env.unwrapped
    run(env, draw_actions(3, 3))
    saved = base.get_state_dict()
    run(env, draw_actions(2, 3, seed=1))
    current = base.get_state_dict()
    worlds = torch.tensor([2])
    rows = common.index_dict_array(saved, worlds, inplace=False)
    env.reset(options={"env_idx": worlds, "reset_to_env_states": {"env_states": rows}})
    assert_equal(base.get_state_dict(), saved, [2], [2])
    assert_equal(base.get_state_dict(), current, [0, 1], [0, 1])
    assert base.elapsed_steps.tolist() == [5, 5, 0]


def test_a_state_without_the_controllers_restores_the_same(make_env, draw_actions):
    """ManiSkill restores such states; the targets of the controllers are those of the solver's grippers."""
    env = make_env()
    base = env.unwrapped
    run(env, draw_actions(3, 3))
    whole = base.get_state_dict()
    env.reset(seed=9)
    base.set_state_dict({name: group for name, group in whole.items() if name != "controller"})
    assert_equal(base.get_state_dict(), whole)


def test_states_of_another_environment_are_refused(make_env):
    state = make_env(2).unwrapped.get_state_dict()
    with pytest.raises(ValueError, match="must be"):
        make_env(2, resolution=50).unwrapped.set_state_dict(state)
    with pytest.raises(ValueError, match="flat state must be"):
        make_env(2).unwrapped.set_state(torch.zeros(2, 3))
    with pytest.raises(ValueError, match="missing"):
        make_env(2).unwrapped.set_state_dict({"actors": {}})


# ---------------------------------------------------------------- rigid motions


@pytest.mark.parametrize(
    ("rotation", "translation", "message"),
    [
        (torch.diag(torch.tensor([1.0, 1.0, -1.0])), torch.zeros(3), "must be orthogonal with determinant 1"),
        (2.0 * torch.eye(3), torch.zeros(3), "must be orthogonal with determinant 1"),
        (torch.ones(3, 3), torch.zeros(3), "must be orthogonal with determinant 1"),
        (torch.stack([torch.eye(3), torch.eye(3), -torch.eye(3)]), torch.zeros(3), "must be orthogonal with determinant 1"),
        (torch.full((3, 3), torch.nan), torch.zeros(3), "rotation must be finite"),
        (torch.eye(3), torch.tensor([0.0, torch.inf, 0.0]), "translation must be finite"),
        (torch.eye(2), torch.zeros(3), r"rotation must be \(3, 3\) or \(3, 3, 3\), got \(2, 2\)"),
        (torch.eye(3), torch.zeros(2, 3), r"translation must be \(3,\) or \(3, 3\), got \(2, 3\)"),
    ],
)
def test_what_is_no_rigid_motion_is_refused_and_changes_nothing(make_env, rotation, translation, message):
    base = make_env().unwrapped
    before = base.get_state_dict()
    with pytest.raises(ValueError, match=message):
        base.move_worlds(rotation, translation)
    assert_equal(base.get_state_dict(), before)


# ---------------------------------------------------------------- failures and bad inputs


def test_sparse_rewards_follow_success_and_failure(make_env):
    env = make_env(reward_mode="sparse")
    env.reset(seed=0)
    solver = env.unwrapped.solver
    solver.gravity[:] = 0  # so that worlds stay as they are put
    solver.positions[0] = env.unwrapped.goal_positions[0]
    held = env.unwrapped.start_nodes[0]
    solver.gripper_positions[0] = solver.gripper_targets[0] = solver.positions[0, held]
    solver.velocities[1, 5] = 1e30
    _, reward, terminated, _, info = env.step(torch.zeros(3, 12))
    assert info["success"].tolist() == [True, False, False]
    assert reward.tolist() == [1, -1, 0]
    assert terminated.tolist() == [True, True, False]


@pytest.mark.parametrize("num_envs", [1, 3])
@pytest.mark.parametrize("as_numpy", [False, True])
def test_bad_actions_are_refused_and_change_nothing(make_env, num_envs, as_numpy):
    env = make_env(num_envs)
    before = env.unwrapped.get_state_dict()
    for bad, message in (
        (np.full((num_envs, 12), np.nan), "must be finite"),
        (np.full((num_envs, 12), np.inf), "must be finite"),
        (np.zeros((num_envs, 9)), "must have shape"),
        (np.zeros(9), "must have shape"),
        (np.zeros((num_envs + 1, 12)), "must have shape"),
    ):
        with pytest.raises(ValueError, match=message):
            env.step(bad.astype(np.float32) if as_numpy else torch.as_tensor(bad, dtype=torch.float32))
    if num_envs == 1:
        with pytest.raises(ValueError, match="must be finite"):
            env.step(np.full(12, np.nan, dtype=np.float32))
    assert_equal(env.unwrapped.get_state_dict(), before)


def test_no_action_holds_the_grippers_still(make_env):
    env = make_env()
    before = env.unwrapped.solver.gripper_positions.clone()
    env.step(None)
    assert torch.equal(env.unwrapped.solver.gripper_positions, before)


def test_more_worlds_than_memory_holds_are_refused_before_any_is_made(monkeypatch):
    """ManiSkill seeded a thousand million random generators first, and the machine stood still."""

    def make(*_, **__):
        raise AssertionError("worlds are being made")

    monkeypatch.setattr(BaseEnv, "__init__", make)
    with pytest.raises(ValueError, match=r"num_envs=1000000000 worlds need 57\d\d\.\d GiB for their random numbers alone"):
        gym.make("RopeShaping-v1", num_envs=10**9)
    with pytest.raises(AssertionError, match="worlds are being made"):
        gym.make("RopeShaping-v1", num_envs=2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"obs_mode": "grahp"}, "unknown observation mode"),
        ({"pose_range": "third"}, r"pose_range must be one of \['full', 'half', 'quarter'\], got 'third'"),
        ({"graph_nodes": 3}, r"graph_nodes must be in \[4, 41\]"),
        ({"graph_nodes": 42}, r"graph_nodes must be in \[4, 41\]"),
        ({"sim_backend": "tpu"}, "unknown sim_backend 'tpu'"),
        ({"render_mode": "rgb"}, "render_mode must be one of"),
        ({"num_envs": 0}, "num_envs must be >= 1"),
        ({"sim_config": {"sim_freq": 100}}, "sim_freq equal to control_freq"),
        ({"num_grippers": 1}, r"num_grippers must be one of \[2, 3, 4\], got 1"),
        ({"num_grippers": 5}, r"num_grippers must be one of \[2, 3, 4\], got 5"),
        ({"robot_uids": "panda"}, "grips for .* arms, got 1"),
        ({"robot_uids": "floating_grippers_2", "num_grippers": 3}, "contradicts"),
        ({"resolution": 19}, r"resolution must be in \[20, 200\] nodes, got 19"),
        ({"resolution": 201}, r"resolution must be in \[20, 200\]"),
        ({"goal_shape": "X"}, "goal shapes must be among W, V, U, S, L, O, spiral"),
        ({"shapes": ("W", "Y")}, "goal shapes must be among"),
        ({"shapes": ()}, "goal shapes must be among"),
    ],
)
def test_bad_options_are_refused_with_what_is_allowed(make_env, options, message):
    with pytest.raises(ValueError, match=message):
        make_env(**options)
