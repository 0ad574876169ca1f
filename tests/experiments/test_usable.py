"""Runs of different code never stand side by side, and what is left out is named."""

import dataclasses
import json

import pytest
from synthetic_results import CODE, EASY, HARD, OURS, STUDY, THEIRS, results_of, run_of, write_results

from maniskill_grpd.experiments.fingerprints import Mark, group
from maniskill_grpd.experiments.pages import write_study_page
from maniskill_grpd.experiments.study_data import StudyData
from maniskill_grpd.runs.source import fingerprint_code


def mark(subject="a", behaviour="", code=""):
    return Mark(subject, behaviour, code)


@pytest.mark.parametrize(
    ("marks", "expected"),
    [
        ([mark(code="1"), mark(code="1"), mark(code="2")], [True, False]),
        ([mark(behaviour="x"), mark(behaviour="x"), mark(behaviour="y")], [True, False]),
        # the same hash of another subject says nothing
        ([mark(behaviour="x"), mark("b", behaviour="x"), mark()], [False, False]),
        # rearranged source that does the same, and a third run that shares the new source
        ([mark(behaviour="x", code="1"), mark(behaviour="x", code="2"), mark("b", behaviour="z", code="2")], [True, True]),
        # either difference alone would do, but neither is the same
        ([mark(behaviour="x", code="1"), mark(behaviour="y", code="2"), mark("b", "x", "3")], [False, False]),
    ],
)
def test_marks_of_the_same_code_have_the_same_number(marks, expected):
    first, second, third = group(marks)
    assert [first == second, second == third] == expected


def test_a_mark_that_says_nothing_belongs_nowhere():
    assert group([mark(), mark(), mark(code="1")])[:2] == [None, None]


@pytest.fixture
def results():
    """Two seeds of ours and one of theirs, tested under noise too."""
    runs = [run_of(EASY, OURS), run_of(EASY, OURS, 2), run_of(EASY, THEIRS)]
    return results_of({run: {"as trained": 10.0, "sigma=0.1": 5.0} for run in runs})


def scores(results, arm=OURS, condition="as trained"):
    return StudyData(STUDY, results).scores(EASY, arm, condition, "return")


def test_runs_of_one_code_are_all_shown(results):
    data = StudyData(STUDY, results)
    assert data.left_out == {}
    assert data.is_older(EASY)
    assert not data.is_older(HARD)  # nothing there
    assert scores(results) == {1: 10.0, 2: 10.0}


def test_a_run_of_other_code_is_left_out_and_named(results):
    stranger = run_of(EASY, OURS, 2).name
    results.runs[stranger]["code"] = "1" * 16
    assert scores(results) == {1: 10.0}
    assert StudyData(STUDY, results).left_out == {stranger: "of other code than the rest"}


def test_a_run_without_a_fingerprint_is_left_out(results):
    stranger = run_of(EASY, THEIRS).name
    results.runs[stranger]["code"] = ""
    assert StudyData(STUDY, results).left_out == {stranger: "without a fingerprint"}
    assert scores(results, THEIRS) == {}


def test_a_test_played_with_other_code_is_left_out_but_not_its_run(results):
    name = run_of(EASY, OURS).name
    results.tests[name, "sigma=0.1"]["code"] = "1" * 16
    assert scores(results, condition="sigma=0.1") == {2: 5.0}
    assert scores(results) == {1: 10.0, 2: 10.0}
    assert list(StudyData(STUDY, results).left_out) == [f"{name}, sigma=0.1"]


def test_the_present_code_is_preferred_to_more_runs_of_an_older_one(results):
    name = run_of(EASY, OURS).name
    for row in (results.runs[name], results.tests[name, "as trained"]):
        row["code"] = fingerprint_code()
    data = StudyData(STUDY, results)
    assert data.scores(EASY, OURS, "as trained", "return") == {1: 10.0}
    assert not data.is_older(EASY)
    assert len(data.left_out) == 3  # two runs, and the test under noise of the third


def test_rearranged_source_that_does_the_same_is_not_older(results):
    for row in results.runs.values():
        row |= {"config": json.dumps({"policy": row["run"][:1], "seed": row["seed"]}), "solver": "s", "task": "t", "learner": "l"}

    def present(run):
        return dataclasses.replace(Mark.of_run(results.runs[run.name]), code=fingerprint_code())

    assert not StudyData(STUDY, results, present=present).is_older(EASY)
    assert StudyData(STUDY, results, present=lambda run: Mark("another", "s t l", fingerprint_code())).is_older(EASY)


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"training_return": float("nan")}, "not finite: training_return"), ({"config": '{"total_timesteps": 7}'}, "trained for 7")],
)
def test_runs_that_are_not_whole_are_left_out(results, change, reason):
    name = run_of(EASY, OURS).name
    results.runs[name] |= change
    (found,) = StudyData(STUDY, results).left_out.items()
    assert found[0] == name
    assert found[1].startswith(reason)


def test_sides_of_different_code_are_not_compared():
    scores = {run_of(task, arm, seed): {"as trained": 1.0} for task in (EASY, HARD) for arm in (OURS, THEIRS) for seed in (1, 2)}
    results = results_of(scores)
    assert StudyData(STUDY, results).findings()[2][1].verdict != "not run"
    for table in (results.runs.values(), results.tests.values()):
        for row in table:
            row["code"] = "1" * 16 if row["run"].startswith("Hard") else CODE
    data = StudyData(STUDY, results)
    assert data.left_out == {}
    assert data.findings()[2][1].verdict == "not run"


def test_a_page_says_what_is_older_and_what_is_left_out(results, tmp_path):
    results.runs[run_of(EASY, THEIRS).name]["code"] = "1" * 16
    write_results(tmp_path / "data", results)
    text = write_study_page(STUDY, tmp_path).read_text()
    assert "**Older than the present code**, which does something else: Easy-v1." in text
    assert f"- `{run_of(EASY, THEIRS).name}`: of other code than the rest" in text
