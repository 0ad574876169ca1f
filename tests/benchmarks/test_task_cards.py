"""The page of the tasks says what their docstrings say."""

import json
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

import task_cards

DOCS = Path(__file__).parents[2] / "docs"


def test_the_page_is_that_of_the_docstrings_and_the_measurements(tmp_path):
    rows = json.loads((DOCS / "benchmarks" / "tasks.json").read_text())
    task_cards.write_page(tmp_path / "tasks.md", rows)
    assert (tmp_path / "tasks.md").read_text() == (DOCS / "tasks.md").read_text()


def test_every_expert_was_measured_to_succeed():
    rows = json.loads((DOCS / "benchmarks" / "tasks.json").read_text())
    played = [row for row in rows if row.get("policy") == "expert"]
    assert {row["env"] for row in played} == {"ClothFolding-v1", "ClothHanging-v1", "RopeShaping-v1", "RopeWrapping-v1"}
    assert all(row["num_episodes"] == 200 and row["success_at_end"] >= 0.9 for row in played)
