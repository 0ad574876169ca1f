"""Runs become rows, and rows are kept in three files."""

import json

import pytest
from synthetic_results import EASY, OURS, run_of

from maniskill_grpd.experiments.records import training_metrics
from maniskill_grpd.experiments.results import load_results, save_runs

RUN = run_of(EASY, OURS)


def write_run(folder, success=0.5, name=RUN.name):
    """Write what a training of two iterations and two tests leave."""
    run_dir = folder / name
    (run_dir / "tests").mkdir(parents=True)
    record = {
        "config": {"env_id": "Easy-v1", "policy": "grpd", "algorithm": "bpp", "seed": 1, "total_timesteps": 1000},
        "device": "cpu",
        "device_name": "a core",
        "python": "3.11",
        "versions": {"torch": "2"},
        "git": {"commit": "abc", "dirty": False},
    }
    (run_dir / "config.json").write_text(json.dumps(record))
    rows = [
        {
            "kind": "train",
            "iteration": 1,
            "global_step": 500,
            "time/update_time": 1.0,
            "time/rollout_time": 2.0,
            "losses/kl_projected": 0.1,
            "losses/kl_acting": 0.5,
        },
        {"kind": "eval", "iteration": 1, "global_step": 500, "eval/return": 10.0, "eval/success_at_end": 0.0},
        {
            "kind": "train",
            "iteration": 2,
            "global_step": 1000,
            "time/update_time": 3.0,
            "time/rollout_time": 4.0,
            "losses/kl_projected": 0.3,
            "losses/kl_acting": 0.7,
        },
        {"kind": "eval", "iteration": 2, "global_step": 1000, "eval/return": 30.0, "eval/success_at_end": success},
    ]
    (run_dir / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    test = {"condition": "as trained", "sigma": 0.0, "num_episodes": 5, "first_seed": 7, "global_step": 1000, "env_kwargs": {}}
    (run_dir / "tests" / "a.json").write_text(json.dumps({**test, "mean": {"return": 33.0, "success_at_end": success}}))
    refused = {**test, "condition": "sigma=0.1", "error": "no"}
    (run_dir / "tests" / "b.json").write_text(json.dumps(refused))
    return run_dir


def test_a_run_is_told_by_its_row(tmp_path):
    save_runs(tmp_path / "data", [(RUN.name, write_run(tmp_path), "finished")])
    results = load_results(tmp_path / "data")
    row = results.runs[RUN.name]
    assert (row["policy"], row["seed"], row["budget"], row["commit"]) == ("grpd", "1", "1000", "abc")
    assert (row["device_name"], json.loads(row["versions"])) == ("a core", {"torch": "2"})
    assert json.loads(row["config"])["env_id"] == "Easy-v1"
    assert results.score(RUN, "iteration_seconds", "as trained") == 5.0  # median of 3 and 7
    assert results.score(RUN, "training_return", "as trained") == 20.0
    assert results.score(RUN, "kl_projected", "as trained") == pytest.approx(0.2)
    assert results.score(RUN, "kl_acting", "as trained") == pytest.approx(0.6)
    assert results.score(RUN, "return", "as trained") == 33.0
    assert results.score(RUN, "return", "sigma=0.1") is None
    assert results.tests[RUN.name, "sigma=0.1"]["error"] == "no"
    assert list(results.curve(RUN, "return").scores) == [10.0, 30.0]


def test_a_run_replaces_its_rows_and_leaves_the_others(tmp_path):
    other = run_of(EASY, OURS, seed=2)
    runs = [(run.name, write_run(tmp_path, name=run.name), "finished") for run in (RUN, other)]
    save_runs(tmp_path / "data", runs)
    save_runs(tmp_path / "data", [(RUN.name, write_run(tmp_path / "again", success=1.0), "finished")])
    results = load_results(tmp_path / "data")
    assert results.score(RUN, "success_at_end", "as trained") == 1.0
    assert results.score(other, "success_at_end", "as trained") == 0.5
    assert len(results.curves[RUN.name]) == 2
    assert len((tmp_path / "data" / "runs.csv").read_text().splitlines()) == 3


def test_a_failed_run_is_in_the_files_but_scores_nothing(tmp_path):
    save_runs(tmp_path / "data", [(RUN.name, write_run(tmp_path), "failed"), ("broken", tmp_path / "nowhere", "failed")])
    results = load_results(tmp_path / "data")
    assert results.state(RUN) == results.runs["broken"]["state"] == "failed"
    assert results.score(RUN, "return", "as trained") is None
    assert results.curve(RUN, "return") is None


def test_files_do_not_depend_on_the_order_of_saving(tmp_path):
    runs = [(run.name, write_run(tmp_path, name=run.name), "finished") for run in (RUN, run_of(EASY, OURS, seed=10))]
    save_runs(tmp_path / "a", runs)
    save_runs(tmp_path / "b", runs[1:])
    save_runs(tmp_path / "b", runs[:1])
    for name in ("runs", "tests", "curves"):
        assert (tmp_path / "a" / f"{name}.csv").read_bytes() == (tmp_path / "b" / f"{name}.csv").read_bytes()


def test_a_training_without_evaluations_still_has_times():
    rows = [{"kind": "train", "time/update_time": 1.0, "time/rollout_time": 0.5}]
    assert training_metrics(rows) == {"iteration_seconds": 1.5, "update_seconds": 1.0, "rollout_seconds": 0.5}
    assert training_metrics([]) == {}


def test_no_files_are_no_results(tmp_path):
    results = load_results(tmp_path)
    assert (results.runs, results.state(RUN)) == ({}, "not run")


@pytest.mark.parametrize(
    ("table", "damage", "message"),
    [
        ("runs", lambda lines: [], "runs.csv, line 1: no column run"),
        ("runs", lambda lines: [lines[0].replace("run,", "name,", 1), *lines[1:]], "runs.csv, line 1: no column run"),
        ("runs", lambda lines: [*lines[:-1], lines[-1][:30]], "runs.csv, line 3: "),
        ("runs", lambda lines: [*lines, lines[1]], "runs.csv, line 4: a second row of "),
        (
            "runs",
            lambda lines: [lines[0], lines[1].replace("finished", "fnished"), lines[2]],
            "line 2: state must be finished or",
        ),
        (
            "tests",
            lambda lines: [*lines[:3], lines[3].rpartition(",")[0], *lines[4:]],
            r"tests.csv, line 4: \d+ fields, where the",
        ),
        ("tests", lambda lines: [*lines[:-1], lines[-1] + ",9"], r"tests.csv, line 5: \d+ fields, where the head has \d+"),
        (
            "tests",
            lambda lines: [lines[0], lines[1].replace("33.0", "3x3"), *lines[2:]],
            "line 2: return must be a number, got '3x3'",
        ),
        (
            "curves",
            lambda lines: [*lines[:2], lines[2].replace("1000", "?"), *lines[3:]],
            "curves.csv, line 3: step must be a number",
        ),
    ],
    ids=["empty", "no head", "cut short", "twice", "state", "field lost", "field too many", "no number", "no step"],
)
def test_a_damaged_table_is_named_with_its_line_and_left_as_it_is(tmp_path, table, damage, message):
    """It was a bare KeyError or "could not convert string to float", in a command that had trained for hours."""
    other = run_of(EASY, OURS, seed=2)
    runs = [(run.name, write_run(tmp_path, name=run.name), "finished") for run in (RUN, other)]
    data = tmp_path / "data"
    save_runs(data, runs)
    path = data / f"{table}.csv"
    path.write_text("\n".join(damage(path.read_text().splitlines())))
    before = {file.name: file.read_bytes() for file in data.iterdir()}
    with pytest.raises(ValueError, match=message) as error:
        load_results(data)
    assert str(path) in str(error.value)
    with pytest.raises(ValueError, match=message):
        save_runs(data, runs[:1])
    assert {file.name: file.read_bytes() for file in data.iterdir()} == before


def test_a_table_without_rows_can_be_read_again(tmp_path):
    save_runs(tmp_path, [])
    assert load_results(tmp_path).runs == {}


def test_a_damaged_test_of_a_run_is_named(tmp_path):
    run_dir = write_run(tmp_path)
    (run_dir / "tests" / "a.json").write_text('{"condition": "as trained",\n"sig')
    with pytest.raises(ValueError, match=r"a\.json, line 2: damaged"):
        save_runs(tmp_path / "data", [(RUN.name, run_dir, "finished")])
