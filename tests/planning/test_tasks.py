"""The planner in the four tasks: it knows their rewards alone, and leaves their worlds as they are."""

import gc

import gymnasium as gym
import pytest
import torch

from maniskill_grpd.experts import make_expert
from maniskill_grpd.learning import CheckpointError, TrainConfig
from maniskill_grpd.planning import Planner, PlannerOptions, PolicyPrior, SampleWorlds
from maniskill_grpd.planning.episodes import make_planner
from maniskill_grpd.policies import make_policy

TASKS = {
    "ClothFolding-v1": {"resolution": 49},
    "ClothHanging-v1": {"resolution": 64},
    "RopeShaping-v1": {"resolution": 20},
    "RopeWrapping-v1": {"resolution": 20},
}
OPTIONS = PlannerOptions(horizon=16, samples=24, iterations=2, first_iterations=5, replan=8)


@pytest.fixture
def make_env(monkeypatch):
    """Return a function that makes a task."""
    monkeypatch.setattr(gc, "collect", lambda: 0)
    made = []

    def make(env_id, num_envs, obs_mode="none", **options):
        options = {**TASKS[env_id], **options}
        made.append(gym.make(env_id, num_envs=num_envs, obs_mode=obs_mode, sim_backend="cpu", render_backend="none", **options))
        made[-1].reset(seed=3)
        return made[-1]

    yield make
    for env in made:
        env.close()


LEADS = {"ClothFolding-v1": 12}
"""Steps that the expert takes first: on the way up a fold brings less than lying still, which takes a long search to overcome."""


def last_reward(env, act, steps=16):
    env.reset(seed=[3])
    env_id = env.spec.id
    expert = make_expert(env_id, env)
    for _ in range(LEADS.get(env_id, 0)):
        env.step(expert.act())
    for _ in range(steps):
        reward = env.step(act())[1]
    return reward.item()


@pytest.mark.parametrize("env_id", TASKS)
def test_a_few_steps_that_are_planned_bring_more_than_standing_still_and_chance(env_id, make_env):
    env = make_env(env_id, 1)
    planner = Planner(SampleWorlds(make_env(env_id, OPTIONS.samples), OPTIONS.samples, final_weight=10.0), OPTIONS)
    generator = torch.Generator().manual_seed(0)
    width = len(planner.worlds.rest_action)
    planned = last_reward(env, lambda: planner.act(env.unwrapped.get_state_dict()))
    still = last_reward(env, lambda: planner.worlds.rest_action[None])
    random = last_reward(env, lambda: 2.0 * torch.rand(1, width, generator=generator) - 1.0)
    assert planned > 1.1 * max(still, random)


@pytest.mark.parametrize("env_id", ["ClothHanging-v1", "RopeShaping-v1"])
def test_worlds_hold_the_states_of_the_episodes_and_plans_bring_what_was_foretold(env_id, make_env):
    env, samples = make_env(env_id, 2), make_env(env_id, 6)
    worlds = SampleWorlds(samples, 3)
    for _ in range(3):  # not the state in which the worlds would start
        env.step(torch.full((2, 12), 0.3))
    before = env.unwrapped.get_state_dict()
    worlds.enter(before)
    inside = samples.unwrapped.get_state_dict()
    for part in before:
        for name, leaf in before[part].items():
            assert torch.equal(inside[part][name], leaf.repeat_interleave(3, dim=0)), (part, name)
    plans = torch.rand(2, 3, 5, 12, generator=torch.Generator().manual_seed(1)) - 0.5
    foretold = worlds.play(before, plans)
    after = env.unwrapped.get_state_dict()
    assert all(torch.equal(after["solver"][name], leaf) for name, leaf in before["solver"].items())
    for sample in range(3):
        env.unwrapped.set_state_dict(before)
        rewards = [env.step(plans[:, sample, step])[1] for step in range(5)]
        assert torch.equal(sum(rewards), foretold[:, sample])


def test_a_prior_proposes_what_its_policy_does_and_a_search_does_not_lose_it(make_env):
    env, samples = make_env("RopeShaping-v1", 1, "graph"), make_env("RopeShaping-v1", 8, "graph")
    policy = make_policy("grpd", env.unwrapped.graph_schema)
    prior = PolicyPrior(policy, None, TrainConfig(env_id="RopeShaping-v1"))
    worlds = SampleWorlds(samples, 8)
    obs, _ = env.reset(seed=[5])
    start = env.unwrapped.get_state_dict()
    plan = prior.propose(worlds, start, 4)
    brought = 0.0
    for step in range(4):
        action = policy.act(obs["graph"], deterministic=True)
        torch.testing.assert_close(action, plan[:, step], atol=1e-5, rtol=0)
        obs, reward, *_ = env.step(action)
        brought += reward
    options = PlannerOptions(horizon=4, replan=2, samples=8, elite_share=0.25, iterations=1)
    found = Planner(worlds, options, prior).search(start, torch.zeros(1, 4, 12), 1)
    searched = worlds.play(start, found[:, None].expand(-1, 8, -1, -1))[:, 0]
    assert searched >= brought - 1e-4


def test_grippers_that_open_rest_closed(make_env):
    worlds = SampleWorlds(make_env("RopeShaping-v1", 2, grasp="free"), 2)
    assert worlds.rest_action.view(-1, 4).tolist() == [[0.0, 0.0, 0.0, 1.0]] * 4


def test_several_agents_are_refused(make_env):
    with pytest.raises(ValueError, match="plans are made for one agent"):
        SampleWorlds(make_env("RopeShaping-v1", 2, robot_uids=("floating_grippers_1", "floating_grippers_1")), 2)


def test_priors_that_do_not_fit_are_refused(make_env):
    shown = make_env("RopeWrapping-v1", 1, "graph").unwrapped.graph_schema
    prior = PolicyPrior(make_policy("grpd", shown), None, TrainConfig(env_id="RopeWrapping-v1"))
    task = TrainConfig(env_id="RopeShaping-v1", env_kwargs=("resolution=20",), sim_backend="cpu")
    with pytest.raises(CheckpointError, match="trained on other observations"):
        make_planner(task, 1, OPTIONS, prior)
    with pytest.raises(ValueError, match="value function of the policy was never trained"):
        make_planner(task, 1, OPTIONS, prior, use_value=True)
    with pytest.raises(CheckpointError, match="a prior looks at graphs"):
        prior.check(make_env("RopeWrapping-v1", 1))
    free = make_env("RopeWrapping-v1", 1, "graph", grasp="free")
    blind = PolicyPrior(make_policy("grpd", free.unwrapped.graph_schema), None, TrainConfig(env_id="RopeWrapping-v1"))
    with pytest.raises(CheckpointError, match="gives 3 numbers for each gripper, and this task takes 4"):
        blind.check(free)
