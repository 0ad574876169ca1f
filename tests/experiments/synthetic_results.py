"""Results of runs that never were, for tests of what is made of results."""

from __future__ import annotations

import csv
from pathlib import Path

from maniskill_grpd.experiments import Arm, Condition, Study, Task
from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.results import Results
from maniskill_grpd.experiments.study import AS_TRAINED, Run

NOISY = Condition(sigma=0.1, factors={"sigma": 0.1})
EASY = Task(env_id="Easy-v1", options={"resolution": 10}, conditions=(AS_TRAINED, NOISY))
HARD = Task(env_id="Hard-v1", options={"resolution": 20})
CODE = "0" * 16
"""Fingerprint of the code of all runs."""
OURS, THEIRS = Arm(name="ours"), Arm(name="theirs", policy="empn")
STUDY = Study(
    name="toy",
    title="Toy",
    question="Is ours better?",
    tasks=(EASY, HARD),
    arms=(OURS, THEIRS),
    plots=("bars", "curves", "profile", "lines", "heat_map"),
    factor="sigma",
    claims=(
        Claim(
            text="Better",
            source="I",
            paper="+50 %",
            measure="gain",
            metric="return",
            at_least=0.0,
            ours=Side("ours", "Easy-v1"),
            theirs=Side("theirs", "Easy-v1"),
        ),
        Claim(
            text="Keeps",
            source="II",
            paper="85 %",
            measure="ratio",
            metric="return",
            at_least=0.85,
            ours=Side("ours", "Easy-v1", ("sigma=0.1",)),
            theirs=Side("ours", "Easy-v1"),
        ),
        Claim(
            text="Everywhere",
            source="III",
            paper="-",
            measure="gain",
            metric="return",
            at_least=0.0,
            ours=Side("ours"),
            theirs=Side("theirs"),
        ),
    ),
)


def run_of(task: Task, arm: Arm, seed: int = 1, budget: int = 1000) -> Run:
    """Return a run of the study."""
    return Run(task=task, arm=arm, seed=seed, budget=budget)


def results_of(scores: dict[Run, dict[str, float]], failed: tuple[Run, ...] = ()) -> Results:
    """Return results in which runs have given returns by condition; success is a hundredth of the return.

    Every run has learning curves of two points, at half of the budget and at the end.
    """
    runs, tests, curves = {}, {}, {}
    for run, returns in scores.items():
        runs[run.name] = {
            "run": run.name,
            "state": "finished",
            "seed": run.seed,
            "budget": run.budget,
            "device": "cpu",
            "code": CODE,
        }
        for condition, value in returns.items():
            key = (run.name, condition)
            tests[key] = {"run": run.name, "condition": condition, "return": value, "success_at_end": value / 100, "code": CODE}
        final = next(iter(returns.values()))
        curves[run.name] = [
            {"run": run.name, "step": run.budget * share // 2, "return": final * share / 2, "success_at_end": final * share / 200}
            for share in (1, 2)
        ]
    for run in failed:
        runs[run.name] = {"run": run.name, "state": "failed", "seed": run.seed, "budget": run.budget}
    return Results(runs, tests, curves)


def write_results(folder: Path, results: Results) -> None:
    """Write results as the CSV files that `load_results` reads."""
    folder.mkdir(parents=True, exist_ok=True)
    tables = {
        "runs": list(results.runs.values()),
        "tests": list(results.tests.values()),
        "curves": [row for rows in results.curves.values() for row in rows],
    }
    for name, rows in tables.items():
        with (folder / f"{name}.csv").open("w", encoding="utf-8", newline="") as file:
            writer = csv.DictWriter(file, list(dict.fromkeys(column for row in rows for column in row)))
            writer.writeheader()
            writer.writerows(rows)
