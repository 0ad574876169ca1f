"""Which shapes can be laid: what is planned is told for every episode, and what is known is not planned again."""

import json
import sys

import goal_shape_reachability as reachability

from maniskill_grpd.planning import PlannerOptions


def test_planning_brings_the_rope_nearer_to_an_s_than_a_plan_of_one_sample_pair():
    small = PlannerOptions(horizon=10, replan=5, samples=8, elite_share=0.25, iterations=1, first_iterations=1, std=0.1)
    large = PlannerOptions(horizon=10, replan=5, samples=16, iterations=1, first_iterations=2, elite_share=0.2)
    weak, strong = (reachability.plan("S", 4, [7, 8], options) for options in (small, large))
    assert [row["seed"] for row in strong] == [7, 8]
    assert strong[0]["plan_steps"] == (2 + 19) * 16 * 10  # iterations of 20 searches, samples, steps
    assert all(better["mean_distance"] < 0.8 * worse["mean_distance"] for better, worse in zip(strong, weak, strict=True))


def test_rows_that_are_known_are_not_planned_again(tmp_path, monkeypatch, capsys):
    rows = [{"shape": "W", "num_grippers": 4, "seed": 1_000_000}]
    file = tmp_path / "rows.json"
    file.write_text(json.dumps(rows))
    monkeypatch.setattr(sys, "argv", ["", "--shapes", "W", "--num_grippers", "4", "--json", str(file)])
    reachability.main()
    assert json.loads(file.read_text()) == rows
    assert capsys.readouterr().out == ""
