"""The search for plans: a plan that lays the rope is found, and one is played as it is written."""

import json
import sys

import goal_shape_reachability as reachability
import pytest
import torch


@pytest.fixture
def env():
    made = reachability._make("S", 4, 64)
    yield made
    made.close()


def test_grippers_end_where_a_plan_ends_and_equal_plans_cost_the_same(env):
    plans = torch.zeros(64, reachability.NUM_WAYPOINTS, 4, 3)
    plans[1::2, -1, :, 0] = 0.05
    costs, _ = reachability.play_plans(env, 7, plans)
    task = env.unwrapped
    held = task.start_nodes[..., None].expand(-1, -1, 3)
    aside = (task.solver.gripper_positions - task.goal_positions.gather(1, held))[..., 0]
    torch.testing.assert_close(aside[1::2], torch.full((32, 4), 0.05), atol=0.01, rtol=0)  # limited by the taut rope
    assert (costs[::2] == costs[0]).all()
    assert (costs[1::2] == costs[1]).all()


def test_the_search_lowers_the_cost(env):
    first = reachability.search(env, 1_000_000, 1)
    found = reachability.search(env, 1_000_000, 4)
    assert found["mean_distance"] < first["mean_distance"] or first["success"]
    assert found["plays"] <= 4 * 64


def test_rows_that_are_known_are_not_searched_again(tmp_path, monkeypatch, capsys):
    rows = [{"shape": "W", "num_grippers": 4, "seed": 1_000_000}]
    file = tmp_path / "rows.json"
    file.write_text(json.dumps(rows))
    monkeypatch.setattr(sys, "argv", ["", "--shapes", "W", "--num_grippers", "4", "--json", str(file)])
    reachability.main()
    assert json.loads(file.read_text()) == rows
    assert capsys.readouterr().out == ""
