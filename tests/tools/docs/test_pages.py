"""The pages say what the committed measurements and the docstrings say."""

import json

import pytest

pytest.importorskip("mani_skill")

from tools.docs.benchmark_pages import policy_page, slope
from tools.docs.pages import DOCS, pages


@pytest.fixture(scope="module")
def written():
    return pages()


@pytest.mark.parametrize(
    "name",
    [
        "tasks.md",
        "benchmarks/env.md",
        "benchmarks/physics.md",
        "benchmarks/policy.md",
        "benchmarks/train.md",
        "planner.md",
        "results/demonstrations.md",
        "physics/validation.md",
        "physics.md",
        "robots.md",
        "leaderboard.md",
    ],
)
def test_a_page_is_what_make_docs_writes(written, name):
    assert (DOCS / name).read_text() == written[name]


def test_no_page_is_left_out(written):
    assert len(written) == 13


def test_every_expert_was_measured_to_succeed():
    rows = json.loads((DOCS / "benchmarks" / "tasks.json").read_text())
    played = [row for row in rows if row.get("policy") == "expert"]
    assert {row["env"] for row in played} == {"ClothFolding-v1", "ClothHanging-v1", "RopeShaping-v1", "RopeWrapping-v1"}
    assert all(row["num_episodes"] == 200 and row["success_at_end"] >= 0.9 for row in played)


def test_slope_of_a_power_law():
    rows = [{"policy": "a", "mode": "forward", "actuators": 4, "nodes": n, "ms": 3.0 * n**1.5} for n in (100, 200, 1000)]
    assert slope(rows, "a", "forward") == pytest.approx(1.5)


def test_the_summary_of_policies_is_of_the_size_at_which_actuators_were_varied():
    rows = [
        {
            "policy": "a",
            "parameters": 7,
            "mode": mode,
            "actuators": tools,
            "nodes": nodes,
            "ms": float(nodes + tools),
            "peak_mib": nodes,
        }
        for mode in ("forward", "forward+backward")
        for nodes, tools in ((100, 4), (1000, 4), (1200, 4), (1000, 1))
    ]
    rows[0]["machine"] = {}
    assert "1,000 nodes, 4 actuators" in policy_page(rows)
    assert "| a | 7 | 1004.0 |" in policy_page(rows)


def test_shapes_that_the_expert_lays_and_does_not_lay_were_planned_with_two_and_four_grippers():
    searches = json.loads((DOCS / "benchmarks" / "goal_shapes.json").read_text())
    assert {(row["shape"], row["num_grippers"]) for row in searches} == {
        (shape, n) for shape in ("W", "S", "spiral") for n in (2, 4)
    }
    solved = [row for row in searches if row["success_at_end"]]
    assert all(row["mean_distance"] <= 0.03 and row["max_distance"] <= 0.08 for row in solved)
