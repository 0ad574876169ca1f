"""The pages of docs/ that are text made of measurements, by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.physics.validation.record import Check
from tools.docs import benchmark_pages, physics_validation
from tools.docs.arm_tables import robots_page
from tools.docs.demonstrations_page import demonstrations_page, draw_demonstrations
from tools.docs.leaderboard import leaderboard_page, read_results
from tools.docs.planner_page import planner_page
from tools.docs.task_cards import tasks_page

DOCS = Path(__file__).parents[2] / "docs"


def pages() -> dict[str, str]:
    """Return the text of each page, by its name within docs/."""
    checks, strains = _checks(), _rows("physics/strain.json")
    return {
        "tasks.md": tasks_page(
            _rows("benchmarks/tasks.json"), _rows("benchmarks/goal_shapes.json"), _rows("replays/replays.json")
        ),
        "leaderboard.md": leaderboard_page(read_results(DOCS / "leaderboard"), _rows("benchmarks/tasks.json")),
        "benchmarks/cameras.md": benchmark_pages.cameras_page(_rows("benchmarks/cameras.json")),
        "benchmarks/env.md": benchmark_pages.env_page(_rows("benchmarks/env.json")),
        "benchmarks/physics.md": benchmark_pages.physics_page(_rows("benchmarks/physics.json")),
        "benchmarks/policy.md": benchmark_pages.policy_page(_rows("benchmarks/policy.json")),
        "benchmarks/viewer.md": benchmark_pages.viewer_page(_rows("benchmarks/viewer.json")),
        "benchmarks/train.md": benchmark_pages.train_page(_rows("benchmarks/train.json")),
        "robots.md": robots_page((DOCS / "robots.md").read_text(encoding="utf-8"), _rows("benchmarks/arms.json")),
        "planner.md": planner_page(_rows("benchmarks/planner.json")),
        "results/demonstrations.md": demonstrations_page(_rows("results/demonstrations.json")),
        "physics/validation.md": physics_validation.validation_page(checks),
        "physics.md": physics_validation.physics_page((DOCS / "physics.md").read_text(encoding="utf-8"), checks, strains),
    }


def draw() -> None:
    """Draw the plots of the validation of the physics, and the curves of trainings from demonstrations."""
    physics_validation.draw_plots(_checks(), DOCS / "physics")
    draw_demonstrations(_rows("results/demonstrations.json"), DOCS / "results")


def _checks() -> list[Check]:
    return [Check(**{key: row[key] for key in row if key != "holds"}) for row in _rows("physics/validation.json")]


def _rows(name: str) -> list[dict[str, Any]]:
    return json.loads((DOCS / name).read_text(encoding="utf-8"))
