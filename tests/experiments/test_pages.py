"""Tables, pictures and pages, from synthetic results."""

import dataclasses

import pytest
from matplotlib.image import imread
from synthetic_results import EASY, HARD, OURS, STUDY, THEIRS, results_of, run_of, write_results

from maniskill_grpd.experiments import STUDIES
from maniskill_grpd.experiments.pages import write_study_page, write_summary_page
from maniskill_grpd.experiments.results import Results
from maniskill_grpd.experiments.run_study import SMOKE_BUDGET, as_smoke_test
from maniskill_grpd.experiments.study_data import StudyData
from maniskill_grpd.experiments.tables import claim_table, format_summary, score_table

SEEDS = (1, 2, 3)


@pytest.fixture
def results():
    """Ours 60, 62, 64 and half of it under noise; theirs 30, 31, 32 on the easy task; nothing of theirs on the hard one."""
    scores = {}
    for seed in SEEDS:
        scores[run_of(EASY, OURS, seed)] = {"as trained": 58.0 + 2 * seed, "sigma=0.1": 29.0 + seed}
        scores[run_of(EASY, THEIRS, seed)] = {"as trained": 29.0 + seed, "sigma=0.1": 10.0}
        scores[run_of(HARD, OURS, seed)] = {"as trained": 20.0}
    return results_of(scores, failed=(run_of(HARD, THEIRS),))


def rows_of(table):
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()]


def test_cells_hold_mean_and_range_or_say_why_not(results):
    rows = rows_of(score_table(StudyData(STUDY, results), "return"))
    assert rows[0] == ["task", "condition", "steps", "seeds", "ours", "theirs"]
    assert rows[2] == ["Easy-v1", "as trained", "1,000", "3", "62.0 (60.0-64.0)", "31.0 (30.0-32.0)"]
    assert rows[3] == ["Easy-v1", "sigma=0.1", "1,000", "3", "31.0 (30.0-32.0)", "10.0"]
    assert rows[4] == ["Hard-v1", "as trained", "1,000", "0 to 3", "20.0", "failed"]
    assert len(rows) == 5


def test_all_tasks_are_pooled_once_every_arm_has_run_on_them(results):
    scores = {
        run_of(task, arm, seed): {"as trained": 50.0 if task == EASY else 10.0}
        for task in (EASY, HARD)
        for arm in (OURS, THEIRS)
        for seed in SEEDS
    }
    rows = rows_of(score_table(StudyData(STUDY, results_of(scores)), "return"))
    assert rows[-1] == ["all tasks", "as trained", "", "", "30.0", "30.0"]


def test_a_task_with_more_seeds_weighs_no_more_than_the_others():
    scores = {run_of(task, OURS, seed): {"as trained": 50.0 if task == EASY else 10.0} for task in (EASY, HARD) for seed in SEEDS}
    for seed in (4, 5, 6):
        scores[run_of(EASY, OURS, seed)] = {"as trained": 50.0}
    study = dataclasses.replace(STUDY, arms=(OURS,), claims=())
    assert rows_of(score_table(StudyData(study, results_of(scores)), "return"))[-1][-1] == "30.0"


def test_claims_of_few_seeds_are_points_beside_the_paper(results):
    rows = rows_of(claim_table(StudyData(STUDY, results).findings()))
    better, keeps, everywhere = rows[2:]
    # deviations of ours and theirs 2 and 1, the difference 31: 31 / sqrt(2.5) * (1 - 3 / 15)
    assert better == ["Better", "Easy-v1", "I", "+50 %", "+100 %", "-", "+100 %", "+15.7", "1.00", "3", "-", "points"]
    assert keeps[3:7] == ["85 %", "0.50x", "-", "0.50x"]
    assert keeps[-1] == "points"
    assert everywhere[-2:] == ["-", "not run"]


def test_ten_seeds_give_intervals_and_verdicts():
    scores = {run_of(EASY, OURS, seed): {"as trained": 60.0 + seed, "sigma=0.1": 30.0 + seed} for seed in range(1, 11)}
    scores |= {run_of(EASY, THEIRS, seed): {"as trained": 30.0 + seed} for seed in range(1, 11)}
    data = StudyData(STUDY, results_of(scores))
    better, keeps, _ = rows_of(claim_table(data.findings()))[2:]
    assert (better[-3:], keeps[-1]) == (["10", "0.000", "holds"], "does not hold")
    # deviation 3.028 of ten seeds, t of nine degrees of freedom 2.262: 65.5 -+ 2.2
    assert format_summary(data.summary(EASY, OURS, "as trained", "return"), 1) == "65.5 [63.3, 67.7]"


def test_what_has_not_been_run_is_said_to_be_so():
    data = StudyData(STUDY, Results({}, {}, {}))
    assert all(row[-2:] == ["not run", "not run"] for row in rows_of(score_table(data, "return"))[2:])
    assert data.findings()[0][1].verdict == "not run"


def test_seeds_are_those_that_were_tested_under_the_condition():
    scores = {run_of(EASY, arm, seed): {"as trained": 1.0} for arm in (OURS, THEIRS) for seed in SEEDS}
    scores[run_of(EASY, OURS, SEEDS[0])]["sigma=0.1"] = 1.0
    rows = rows_of(score_table(StudyData(STUDY, results_of(scores)), "return"))
    assert [row[3] for row in rows[2:4]] == ["3", "0 to 1"]


def test_only_runs_of_one_budget_are_compared_by_default_the_largest():
    scores = {
        run_of(EASY, OURS, 1, 1000): {"as trained": 1.0},
        run_of(EASY, OURS, 1, 2000): {"as trained": 2.0},
        run_of(EASY, THEIRS, 1, 1000): {"as trained": 3.0},
    }
    results = results_of(scores)
    largest, given = StudyData(STUDY, results), StudyData(STUDY, results, 1000)
    assert (largest.budget(EASY), given.budget(EASY)) == (2000, 1000)
    assert largest.scores(EASY, OURS, "as trained", "return") == {1: 2.0}
    assert largest.scores(EASY, THEIRS, "as trained", "return") == {}
    assert given.scores(EASY, THEIRS, "as trained", "return") == {1: 3.0}


def test_one_seed_has_no_interval():
    data = StudyData(STUDY, results_of({run_of(EASY, OURS): {"as trained": 7.0}}))
    assert format_summary(data.summary(EASY, OURS, "as trained", "return"), 1) == "7.0"


def test_a_page_has_tables_and_pictures_and_comes_out_the_same_twice(results, tmp_path):
    write_results(tmp_path / "data", results)
    page = write_study_page(STUDY, tmp_path)
    text = page.read_text()
    for part in ("# Toy", "Runs finished: 9, failed: 1", "## Claims", "## Success", "## Return", "not by hand"):
        assert part in text
    for kind in ("bars", "curves", "lines", "heat_map"):
        assert f"(toy_{kind}.png)" in text
        picture = imread(tmp_path / f"toy_{kind}.png")
        assert picture[..., :3].std() > 0.02  # not blank
    first = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    write_study_page(STUDY, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()} == first


def test_profile_needs_every_task(results, tmp_path):
    write_results(tmp_path / "data", results)
    assert "(toy_profile.png)" in write_study_page(STUDY, tmp_path).read_text()  # ours is complete
    incomplete = dataclasses.replace(STUDY, arms=(THEIRS,), claims=())
    assert "(toy_profile.png)" not in write_study_page(incomplete, tmp_path).read_text()
    assert not (tmp_path / "toy_profile.png").exists()


def test_notes_are_added_at_the_end(tmp_path):
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "toy.md").write_text("It rained.\n")
    assert write_study_page(STUDY, tmp_path).read_text().endswith("\n\nIt rained.\n")


def test_the_summary_takes_the_largest_budget_of_each_task_in_every_study(tmp_path):
    """A study that shares a task with one of a larger budget still shows its other tasks."""
    shared, other = STUDIES["decoder"].tasks[-1], STUDIES["decoder"].tasks[0]
    first, second = STUDIES["main"].arms[0], STUDIES["decoder"].arms[1]
    scores = {run_of(shared, first, budget=2000): {"as trained": 1.0}, run_of(other, second): {"as trained": 1.0}}
    write_results(tmp_path / "data", results_of(scores))
    rows = rows_of(write_summary_page(tmp_path).read_text())
    row = next(row for row in rows if row[0] == "[decoder](decoder.md)")
    assert row[2:4] == ["1,000, 2,000", "2"]


def test_the_summary_lists_every_study_and_every_claim(tmp_path):
    text = write_summary_page(tmp_path).read_text()
    for study in STUDIES.values():
        assert f"[{study.name}]({study.name}.md)" in text
        for claim in study.claims:
            assert f"| {claim.text} |" in text
    assert text.count("| not run |") >= sum(len(study.claims) for study in STUDIES.values())


def test_a_smoke_test_says_that_it_is_none_of_the_results():
    smoke = as_smoke_test(STUDIES["main"])
    assert smoke.title == "Main results (smoke test)"
    assert "its figures mean nothing" in smoke.question.lower()
    assert not smoke.claims
    assert [run.name for run in smoke.runs(1000, (1,))] != [run.name for run in STUDIES["main"].runs(SMOKE_BUDGET, (1,))]


def test_a_page_of_a_smoke_test_names_its_command(tmp_path):
    text = write_study_page(as_smoke_test(STUDY), tmp_path).read_text()
    assert "`maniskill-grpd study --study toy --quick`" in text
    assert "## Claims" not in text
