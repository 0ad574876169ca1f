"""The planner on worlds whose best plan is known."""

import pytest
import torch

from maniskill_grpd.planning import Planner, PlannerOptions, SampleWorlds
from tests.planning.toy_worlds import ToyWorlds

SMALL = {"horizon": 6, "replan": 2, "samples": 64, "iterations": 4, "first_iterations": 6, "final_weight": 0.0}


def make_planner(num_episodes=1, **options):
    options = PlannerOptions(**{**SMALL, **options})
    return Planner(SampleWorlds(ToyWorlds(num_episodes * options.samples), options.samples), options)


def state(*points):
    return {"mass": {"x": torch.tensor(points)}}


@pytest.mark.parametrize("method", ["cem", "mppi"])
def test_the_optimum_of_a_quadratic_is_found(method):
    """From 0 the goal (1.5, -0.8) takes a full step and a half along x, none of them too long, and the rest stands still."""
    planner = make_planner(method=method, noise_exponent=0.0, std=0.3, samples=256)
    plan = planner.search(state([0.0, 0.0]), torch.zeros(1, 6, 2), 40)[0]
    torch.testing.assert_close(plan[0], torch.tensor([1.0, -0.8]), atol=0.12, rtol=0)
    torch.testing.assert_close(plan[:2].sum(dim=0), ToyWorlds.GOAL, atol=0.12, rtol=0)
    assert plan[2:].abs().max() < 0.25


def test_it_stops_at_a_goal_and_beats_standing_still_and_chance():
    planner, env = make_planner(), ToyWorlds(1)
    rewards = [env.step(planner.act(env.get_state_dict()))[1].item() for _ in range(8)]
    assert env.x[0].sub(ToyWorlds.GOAL).norm() < 0.4
    assert sum(rewards) > 8 * -(ToyWorlds.GOAL.square().sum()) / 3.0
    assert planner.worlds.num_steps == (6 + 3 * 4) * 6 * 64  # the first search and three more; the check does not count


def test_what_is_followed_is_never_worse_than_what_was_begun_with():
    """The best plan and the mean are among those tried, so a search that can only lose keeps what it has."""
    planner = make_planner(samples=8, elite_share=0.25)
    best = torch.zeros(1, 6, 2)
    best[0, 0], best[0, 1] = torch.tensor([1.0, -0.8]), torch.tensor([0.5, 0.0])
    torch.testing.assert_close(planner.search(state([0.0, 0.0]), best, 2), best, atol=1e-6, rtol=0)


def test_what_is_left_of_a_plan_starts_the_next_search(monkeypatch):
    planner = make_planner()
    starts = []
    monkeypatch.setattr(planner, "search", lambda _, start, iterations: starts.append(start) or torch.arange(12.0).view(1, 6, 2))
    actions = torch.cat([planner.act(state([0.0, 0.0])) for _ in range(4)])
    assert actions.tolist() == [[0.0, 1.0], [2.0, 3.0]] * 2
    assert starts[0].abs().max() == 0.0
    assert starts[1][0].flatten().tolist() == [4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 0.0, 0.0, 0.0, 0.0]
    planner.begin([0])
    planner.act(state([0.0, 0.0]))
    assert starts[2].abs().max() == 0.0


def test_equal_seeds_give_equal_plans_and_episodes_do_not_know_each_other():
    start = torch.zeros(1, 6, 2)
    alone, again, pair = make_planner(), make_planner(), make_planner(num_episodes=2)
    alone.begin([5]), again.begin([5]), pair.begin([9, 5])
    first = alone.search(state([0.3, 0.1]), start, 6)
    assert torch.equal(first, again.search(state([0.3, 0.1]), start, 6))
    both = pair.search(state([0.0, 0.0], [0.3, 0.1]), start.expand(2, -1, -1), 6)
    assert torch.equal(both[1], first[0])
    assert not torch.equal(both[0], both[1])
    alone.begin([6])
    assert not torch.equal(alone.search(state([0.3, 0.1]), start, 6), first)


def test_plans_stay_within_the_bounds_of_actions():
    planner = make_planner(std=5.0)
    assert planner.search(state([50.0, 50.0]), torch.zeros(1, 6, 2), 6).abs().max() <= 1.0


def test_returns_are_discounted_sums_and_the_last_reward_counts_more():
    """Rewards are -|x - goal|^2; one axis of unit steps from 0: distances 1.5 - 1 and 1.5 - 2, and 0.8 along y."""
    plans = torch.tensor([[[[1.0, 0.0], [1.0, 0.0]], [[0.0, 0.0], [0.0, 0.0]]]])
    moving, still = -(0.25 + 0.64), -(2.25 + 0.64)
    worlds = SampleWorlds(ToyWorlds(2), 2, discount=0.5, final_weight=3.0)
    expected = torch.tensor([[moving * (1 + 0.5 + 1.5), still * (1 + 0.5 + 1.5)]])
    torch.testing.assert_close(worlds.play(state([0.0, 0.0]), plans), expected)
    valued = SampleWorlds(ToyWorlds(2), 2, discount=0.5, final_weight=3.0, value=lambda obs: obs["x"][:, 0])
    expected = torch.tensor([[moving * 1.5 + 0.25 * 2.0, still * 1.5]])
    torch.testing.assert_close(valued.play(state([0.0, 0.0]), plans), expected)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"forgets": True}, "set_state_dict does not restore mass/x"),
        ({"has_noise": True}, "one state and action lead to different values of mass/x"),
        ({"control_mode": "pd_joint_pos"}, "control mode pd_joint_pos does not take"),
    ],
)
def test_environments_that_cannot_be_planned_in_are_refused(wrong, message):
    env = ToyWorlds(4, **wrong)
    with pytest.raises(ValueError, match=message):
        SampleWorlds(env, 2)


def test_an_environment_without_a_state_is_refused(monkeypatch):
    monkeypatch.delattr(ToyWorlds, "get_state_dict")
    with pytest.raises(ValueError, match="Toy cannot be planned in: it has no get_state_dict"):
        SampleWorlds(ToyWorlds(4), 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"horizon": 4, "replan": 5}, "replan must not exceed horizon = 4, got 5"),
        ({"samples": 10, "elite_share": 0.1}, "less than the two plans"),
        ({"std": 0.0}, r"std must lie in \(0, inf\)"),
        ({"method": "random"}, "method must be one of cem, mppi"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        PlannerOptions(**options).check()


def test_sizes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="5 worlds cannot be shared"):
        SampleWorlds(ToyWorlds(5), 2)
    with pytest.raises(ValueError, match="plans for 1 episodes, got 2 seeds"):
        make_planner().begin([1, 2])
    with pytest.raises(ValueError, match="the options say 64 samples, the worlds are for 4"):
        Planner(SampleWorlds(ToyWorlds(4), 4), PlannerOptions())
