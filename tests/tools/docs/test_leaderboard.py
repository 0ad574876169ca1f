"""The leaderboard shows what the files of results say, and refuses files that say something else."""

import json

import pytest

from tools.docs.leaderboard import ResultError, leaderboard_page, read_results, wilson_interval

RESULT = {
    "task": "A-v1",
    "options": {},
    "learner": "mine",
    "num_seeds": 2,
    "num_episodes": 400,
    "num_successes": 100,
    "steps": 1_000_000,
    "hours": None,
    "hardware": "a CPU",
    "version": "0.1.0",
    "command": "test it",
}


def test_the_interval_solves_the_equation_that_defines_it():
    """Its ends are the rates p from which the measured one is 1.96 deviations sqrt(p (1 - p) / n) away."""
    for bound in wilson_interval(43, 100):
        assert abs(0.43 - bound) == pytest.approx(1.959964 * (bound * (1.0 - bound) / 100) ** 0.5)
    assert wilson_interval(10, 10)[1] == pytest.approx(1.0)
    assert wilson_interval(0, 10)[0] == pytest.approx(0.0)


def test_rows_are_ordered_by_success_and_experts_stand_among_them(tmp_path):
    for name, successes in (("a", 100), ("b", 300)):
        (tmp_path / f"{name}.json").write_text(json.dumps({**RESULT, "learner": name, "num_successes": successes}))
    expert = {
        "env": "A-v1",
        "options": {},
        "policy": "expert",
        "num_episodes": 200,
        "success_at_end": 0.5,
        "machine": {"cpu": "x"},
    }
    page = leaderboard_page(read_results(tmp_path), [expert, {**expert, "policy": "zero"}, {**expert, "options": {"n": 1}}])
    rows = [line.split(" | ") for line in page.splitlines() if line.startswith(("| a", "| b", "| *"))]
    assert [row[0] for row in rows] == ["| b", "| *scripted expert*", "| a"]
    assert [row[2] for row in rows] == ["0.750", "0.500", "0.250"]
    assert "| 1,000,000 | - | a CPU |" in page


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"num_successes": 401}, "num_successes = 401 cannot be"),
        ({"num_seeds": 0}, "num_seeds = 0"),
        ({"steps": "many"}, "steps is 'many'"),
        ({"num_episodes": True}, "num_episodes is True"),
        ({"extra": 1}, "must have the fields task, options"),
    ],
)
def test_files_that_are_no_results_are_refused_by_name(tmp_path, change, message):
    (tmp_path / "x.json").write_text(json.dumps({**RESULT, **change}))
    with pytest.raises(ResultError, match=rf"^x.json.*{message}"):
        read_results(tmp_path)


def test_a_file_that_is_no_json_is_refused(tmp_path):
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(ResultError, match=r"^x.json is no JSON"):
        read_results(tmp_path)
