"""What every task of the package does, whatever it is about."""

import gc

import gymnasium as gym
import h5py
import numpy as np
import pytest
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.trajectory import utils as trajectory_utils
from mani_skill.utils import common
from mani_skill.utils.registration import REGISTERED_ENVS
from mani_skill.utils.wrappers import CPUGymWrapper, RecordEpisode
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv
from scipy.spatial.transform import Rotation

from maniskill_grpd.experiments.studies import MAIN
from maniskill_grpd.experts import EXPERTS
from maniskill_grpd.tasks import DeformableEnv, check_task

TASKS = sorted(uid for uid, spec in REGISTERED_ENVS.items() if issubclass(spec.cls, DeformableEnv))
OBS_MODES = ("graph", "state", "state_dict", "none", "state+graph", "state_dict+graph")
HEADINGS = ("Task Description", "Randomizations", "Success Conditions", "Fail Conditions", "Goal Specification")


@pytest.fixture(params=TASKS)
def make(request, monkeypatch):
    """Return a function that makes one of the tasks on the CPU, reset with seed 0."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    made = []

    def make_task(num_envs=3, **options):
        env = gym.make(request.param, num_envs=num_envs, sim_backend="cpu", render_backend="none", **options)
        env.reset(seed=0)
        made.append(env)
        return env

    make_task.env_id = request.param
    yield make_task
    for env in made:
        env.close()


def actions_for(env, num_steps, seed=0, scale=0.6):
    """Draw actions (T, B, D), some longer than allowed."""
    shape = (num_steps, *np.atleast_2d(env.action_space.low).shape)
    return scale * torch.randn(shape, generator=torch.Generator().manual_seed(seed))


def leaves(tree, path=""):
    for key, value in tree.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{path}/{key}")
        else:
            yield f"{path}/{key}", value


def assert_equal(tree, other, rows=slice(None), other_rows=slice(None)):
    other = dict(leaves(other))
    for path, value in leaves(tree):
        assert torch.equal(value[rows], other[path][other_rows]), path


def test_every_task_has_a_time_limit_and_an_expert():
    assert len(TASKS) >= 4
    assert sorted(EXPERTS) == TASKS
    assert {task.env_id for task in MAIN.tasks} == set(TASKS)  # of the studies
    assert all(REGISTERED_ENVS[uid].max_episode_steps == 100 for uid in TASKS)


def test_every_task_keeps_its_promises(make):
    check_task(make(4))


@pytest.mark.parametrize("uid", TASKS)
def test_cards_have_the_headings_that_the_documentation_generator_expects(uid):
    card = REGISTERED_ENVS[uid].cls.__doc__
    places = [card.index(f"**{heading}:**") for heading in HEADINGS]
    assert places == sorted(places)


# ---------------------------------------------------------------- spaces, modes and wrappers


@pytest.mark.parametrize("obs_mode", OBS_MODES)
def test_observations_and_actions_lie_in_their_spaces(make, obs_mode):
    for num_envs in (1, 3):
        env = make(num_envs, obs_mode=obs_mode)
        obs, _ = env.reset(seed=0)
        assert env.unwrapped.obs_mode == obs_mode
        assert env.observation_space.contains(common.to_numpy(obs))
        obs, reward, terminated, truncated, _ = env.step(env.action_space.sample())
        assert env.observation_space.contains(common.to_numpy(obs))
        assert reward.shape == terminated.shape == truncated.shape == (num_envs,)
        if "graph" in obs_mode:
            env.unwrapped.graph_schema.validate(obs["graph"], values=True)


@pytest.mark.parametrize("obs_mode", ["rgb", "depth", "pointcloud", "graph+rgb"])
def test_image_modes_give_images(make, obs_mode):
    env = gym.make(make.env_id, num_envs=2, sim_backend="cpu", obs_mode=obs_mode)
    obs, _ = env.reset(seed=0)
    assert env.observation_space.contains(common.to_numpy(obs))
    env.close()


def test_the_progress_metric_is_in_info(make):
    env = make()
    progress, info = env.unwrapped.PROGRESS, env.step(None)[4]
    assert info[progress.name].shape == (3,)
    assert info[progress.name].dtype == torch.float32


def test_a_step_measures_once_and_pictures_measure_no_world_for_another(make, monkeypatch):
    env = make(3, render_mode="rgb_array", human_render_camera_configs={"width": 8, "height": 8})
    base, calls = env.unwrapped, []
    measure = base.measure
    monkeypatch.setattr(base, "measure", lambda: calls.append(1) or measure())
    for _ in range(2):
        env.step(None)
    assert len(calls) == 2
    env.render()
    assert len(calls) == 3
    for _ in range(3):
        base.measurement, base.drawing(1), base.compute_dense_reward(None, None, {})
    assert len(calls) == 3


def test_the_measurement_is_that_of_the_present_state(make):
    """After a reset, a restored state and a motion too, not that of the last step."""
    env = make()
    base = env.unwrapped
    state = base.get_state_dict()
    for change in (
        lambda: env.step(actions_for(env, 1)[0]),
        lambda: env.reset(seed=5),
        lambda: base.set_state_dict(state),
        lambda: base.set_state(base.get_state().roll(1, dims=0)),
        lambda: base.move_worlds(*random_motion(3)),
    ):
        change()
        kept, anew = base.measurement.metrics, base.evaluate()
        for name, value in kept.items():
            assert torch.equal(value, anew[name]), name


def test_states_hold_the_nodes(make):
    env = make(obs_mode="state")
    before = env.unwrapped.get_obs()
    env.unwrapped.solver.positions[:, 3] += 0.25
    assert ((env.unwrapped.get_obs() - before).abs() > 0.2).sum(dim=1).ge(3).all()


def test_reward_modes_agree(make):
    rewards = {}
    for mode in ("normalized_dense", "dense", "sparse", "none"):
        env = make(reward_mode=mode)
        env.reset(seed=1)
        rows = [env.step(action) for action in actions_for(env, 3)]
        rewards[mode] = torch.stack([row[1] for row in rows])
        success = torch.stack([row[4]["success"] for row in rows])
    assert torch.equal(rewards["normalized_dense"], rewards["dense"])
    assert ((rewards["dense"] >= 0) & (rewards["dense"] <= 1)).all()
    assert torch.equal(rewards["sparse"], success.float())
    assert not rewards["none"].any()


@pytest.mark.parametrize("control_mode", ["pd_ee_delta_pos", "pd_ee_delta_pos_grip"])
def test_control_modes_have_three_or_four_numbers_per_gripper(make, control_mode):
    env = make(2, control_mode=control_mode)
    base = env.unwrapped
    width = (4 if control_mode.endswith("grip") else 3) * base.num_grippers
    assert env.action_space.shape == (2, width)
    action = torch.zeros(2, width)
    if width == 4 * base.num_grippers:
        action.view(2, -1, 4)[1, :, 3] = 1.0  # world 0 lets go, world 1 holds on
        env.step(action)
        assert not base.solver.closed[0].any()
        assert (base.solver.holder[0] < 0).all()
        assert base.solver.closed[1].all()
    else:
        env.step(action)
        assert base.solver.closed.all()


def test_time_limit_can_be_overridden(make):
    env = make(1, max_episode_steps=3)
    assert [bool(env.step(None)[3]) for _ in range(3)] == [False, False, True]


def test_vector_env_resets_itself_and_reports_episodes(make):
    env = ManiSkillVectorEnv(make(max_episode_steps=2), ignore_terminations=True, record_metrics=True)
    env.reset(seed=0)
    env.step(torch.zeros(env.action_space.shape))
    _, _, _, truncated, info = env.step(torch.zeros(env.action_space.shape))
    assert truncated.all()
    assert {"success_once", "success_at_end", "return", "episode_len"} <= set(info["final_info"]["episode"])
    assert env.unwrapped.elapsed_steps.tolist() == [0, 0, 0]


def test_cpu_gym_wrapper_speaks_plain_gymnasium(make):
    env = CPUGymWrapper(make(1, obs_mode="state"))
    obs, _ = env.reset(seed=3)
    assert env.observation_space.contains(obs)
    _, reward, terminated, _, info = env.step(env.action_space.sample())
    assert isinstance(reward, float)
    assert isinstance(terminated, bool)
    assert isinstance(info["success"], bool)


def test_agents_that_share_the_grippers_do_what_one_does(make):
    one = make(2)
    num = one.unwrapped.num_grippers
    several = make(2, robot_uids=("floating_grippers_1",) * num)
    one.reset(seed=5), several.reset(seed=5)
    for action in actions_for(one, 4):
        reward = one.step(action)[1]
        parts = {f"floating_grippers_1-{index}": part for index, part in enumerate(action.split(3, dim=1))}
        assert torch.equal(several.step(parts)[1], reward)


def test_base_env_is_a_direct_base(make):
    """Learners such as skrl choose their adapter by the direct bases of the innermost class alone."""
    assert BaseEnv in type(make(1).unwrapped).__bases__


@pytest.mark.parametrize("made_within", [True, False])
def test_environments_work_on_either_side_of_inference_mode(make, made_within):
    """Tensors that were made in that mode cannot be written outside it."""
    control = make()
    with torch.inference_mode(made_within):
        env = make()
    actions = actions_for(env, 3)
    for step, action in enumerate(actions):
        with torch.inference_mode((step % 2 == 0) != made_within):
            assert torch.equal(env.step(action)[1], control.step(action)[1])
            env.reset(options={"env_idx": torch.tensor([1])}), control.reset(options={"env_idx": torch.tensor([1])})
    with torch.inference_mode():
        env.reset(seed=4, options={"reconfigure": True})
    env.unwrapped.set_state_dict(control.unwrapped.get_state_dict())
    env.unwrapped.move_worlds(torch.eye(3), torch.zeros(3))
    assert torch.isfinite(env.step(actions[0])[1]).all()
    env.reset()


# ---------------------------------------------------------------- seeds, resets and states


def test_an_episode_depends_on_its_own_seed_alone(make):
    """Same seed, other batch size and place in it: the same episodes, bitwise."""
    single, batch = make(1), make(4)
    obs, _ = single.reset(seed=[11])
    batch_obs, _ = batch.reset(seed=[7, 8, 11, 9])
    assert_equal(batch_obs, obs, [2], [0])
    for action, others in zip(actions_for(single, 3), actions_for(batch, 3, seed=1), strict=True):
        others[2] = action[0]
        assert torch.equal(single.step(action)[1], batch.step(others)[1][[2]])
    obs, _ = single.reset()
    batch_obs, _ = batch.reset(options={"env_idx": torch.tensor([2])})
    assert_equal(batch_obs, obs, [2], [0])


def test_resetting_some_worlds_leaves_the_others_bitwise_unchanged(make):
    env, control = make(), make()
    for each in (env, control):
        each.reset(seed=[1, 2, 3])
        for action in actions_for(each, 3):
            each.step(action)
    before = env.unwrapped.get_state_dict()
    env.reset(options={"env_idx": torch.tensor([1])})
    assert_equal(env.unwrapped.get_state_dict(), before, [0, 2], [0, 2])
    assert env.unwrapped.elapsed_steps.tolist() == [3, 0, 3]
    for action in actions_for(env, 3, seed=1):
        env.step(action), control.step(action)
    assert_equal(env.unwrapped.get_state_dict(), control.unwrapped.get_state_dict(), [0, 2], [0, 2])


@pytest.mark.parametrize("flat", [False, True])
def test_restored_states_continue_bitwise(make, flat):
    env = make(obs_mode="state_dict+graph")
    base = env.unwrapped
    for action in actions_for(env, 3):
        env.step(action)
    saved = base.get_state() if flat else base.get_state_dict()
    obs, actions = base.get_obs(), actions_for(env, 3, seed=1)
    first = [env.step(action) for action in actions]
    env.reset(seed=99)
    (base.set_state if flat else base.set_state_dict)(saved)
    assert_equal(base.get_obs(), obs)
    for action, expected in zip(actions, first, strict=True):
        row = env.step(action)
        assert_equal(row[0], expected[0])
        assert torch.equal(row[1], expected[1])


def test_recorded_actions_replay_exactly(make, tmp_path):
    env = RecordEpisode(make(2), tmp_path, trajectory_name="trajectory", save_video=False)
    env.reset(seed=[21, 22])
    for action in actions_for(env, 4):
        env.step(action)
    env.reset()
    env.close()
    env = make(1)
    with h5py.File(tmp_path / "trajectory.h5") as file:
        for name in file:
            states = trajectory_utils.dict_to_list_of_dicts(file[name]["env_states"])
            env.unwrapped.set_state_dict(states[0])
            for step, action in enumerate(file[name]["actions"]):
                assert float(env.step(action)[1]) == file[name]["rewards"][step]
            now = common.to_numpy(env.unwrapped.get_state_dict())
            np.testing.assert_array_equal(now["solver"]["positions"][0], states[-1]["solver"]["positions"])


def test_bad_actions_are_refused_and_change_nothing(make):
    env = make(2)
    before = env.unwrapped.get_state_dict()
    good = torch.zeros(env.action_space.shape)
    for bad, message in ((good + torch.nan, "must be finite"), (good[:, :-1], "must have shape")):
        with pytest.raises(ValueError, match=message):
            env.step(bad)
    assert_equal(env.unwrapped.get_state_dict(), before)


def test_a_diverged_world_fails_without_touching_the_others(make):
    env, control = make(), make()
    actions = actions_for(env, 2)
    env.step(actions[0]), control.step(actions[0])
    env.unwrapped.solver.velocities[1, 2] = 1e30
    obs, reward, terminated, _, info = env.step(actions[1])
    healthy = control.step(actions[1])
    assert info["fail"].tolist() == [False, True, False]
    assert bool(terminated[1])
    assert reward[1] == 0
    assert all(torch.isfinite(value.float()).all() for _, value in leaves(obs))
    assert_equal(obs, healthy[0], [0, 2], [0, 2])


# ---------------------------------------------------------------- symmetry


def random_motion(seed):
    rotation = torch.as_tensor(Rotation.random(random_state=seed).as_matrix(), dtype=torch.float32)
    return rotation, 0.5 * torch.randn(3, generator=torch.Generator().manual_seed(seed))


def test_reward_success_and_graph_do_not_depend_on_the_frame(make):
    env = make(8)
    base = env.unwrapped
    for action in actions_for(env, 5):
        env.step(action)
    graph, info = base.get_obs()["graph"], base.get_info()
    reward, state = base.get_reward(None, None, info), base.get_state_dict()
    for seed in range(5):
        base.set_state_dict(state)
        rotation, translation = random_motion(seed)
        base.move_worlds(rotation, translation)
        moved, moved_info = base.get_obs()["graph"], base.get_info()
        torch.testing.assert_close(base.get_reward(None, None, moved_info), reward, atol=2e-5, rtol=0)
        assert torch.equal(moved_info["success"], info["success"])
        for kind in ("object", "actuator"):
            there, here = moved[kind], graph[kind]
            mask = here["mask"][..., None]
            torch.testing.assert_close(there["scalars"] * mask, here["scalars"] * mask, atol=1e-4, rtol=0)
            turned = here["vectors"] @ rotation.T
            torch.testing.assert_close(there["vectors"] * mask[..., None], turned * mask[..., None], atol=1e-4, rtol=0)


def test_moved_worlds_take_the_moved_trajectory_and_reset_to_where_they_were(make):
    env = make(4)
    base = env.unwrapped
    rotation, translation = random_motion(7)
    for action in actions_for(env, 2):
        env.step(action)
    state, actions = base.get_state_dict(), actions_for(env, 3, seed=5, scale=0.3)
    expected = torch.stack([env.step(action)[1] for action in actions])
    positions = base.solver.positions @ rotation.T + translation
    base.set_state_dict(state)
    base.move_worlds(rotation, translation)
    turned = (actions.unflatten(2, (-1, 3)) @ rotation.T).flatten(2)
    rewards = torch.stack([env.step(action)[1] for action in turned])
    # Folds and buckles amplify rounding within a few steps, but not to the size of an edge.
    gaps = ((base.solver.positions - positions) * base.solver.node_mask[..., None]).norm(dim=-1)
    assert gaps.max() < 5e-3
    torch.testing.assert_close(rewards, expected, atol=5e-3, rtol=0)
    obs, _ = env.reset(seed=3)
    assert_equal(obs, make(4).reset(seed=3)[0])


# ---------------------------------------------------------------- starts and rewards


def test_ten_thousand_starts_are_sound(make):
    """No start is stretched, below the table or in an obstacle, or solved already."""
    env = make(1000)
    base, solver = env.unwrapped, env.unwrapped.solver
    for seed in range(10):
        _, info = env.reset(seed=seed)
        assert not info["success"].any()
        assert not info["fail"].any()
        for index, model in enumerate(base.models):
            worlds = (solver.variants == index).nonzero()[:, 0]
            first, second = torch.as_tensor(model.edges, dtype=torch.int64).unbind(1)
            lengths = (solver.positions[worlds][:, first] - solver.positions[worlds][:, second]).norm(dim=-1)
            torch.testing.assert_close(lengths, torch.as_tensor(model.rest_lengths).expand_as(lengths), rtol=1e-3, atol=1e-5)
        height = (solver.positions * solver.plane[:, None, :3]).sum(-1) - solver.plane[:, 3:]
        assert height[solver.node_mask].min() > solver.model.radius - 1e-5
        # Contact would push nodes that start inside something out within one step; nothing else moves them fast.
        before = solver.positions.clone()
        env.step(None)
        assert (solver.positions - before).norm(dim=-1).max() < 0.03


@pytest.mark.parametrize("policy", ["random", "still", "push"])
def test_policies_that_do_not_look_earn_little(make, policy):
    """No term can be farmed: far below the half that success alone pays."""
    env = make(32)
    generator = torch.Generator().manual_seed(0)
    width = env.action_space.shape[1]
    direction = torch.randn(32, 1, 3, generator=generator).expand(-1, width // 3, -1).flatten(1)
    rewards = []
    for _ in range(100):
        draws = torch.randn(32, width, generator=generator)
        _, reward, _, _, info = env.step({"random": draws, "still": 0.0 * draws, "push": 3.0 * direction}[policy])
        rewards.append(reward)
    assert torch.stack(rewards).mean() < 0.25
    assert info["success"].float().mean() <= 0.05
