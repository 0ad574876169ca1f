"""The data behind all tables: three tidy CSV files of runs, of their tests and of their learning curves."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from maniskill_grpd.experiments.curves import Curve
from maniskill_grpd.experiments.records import Row, curve_rows, run_row, test_rows
from maniskill_grpd.experiments.study import Run

FILES = {"runs": ("run",), "tests": ("run", "condition"), "curves": ("run", "step")}
"""Tables and what tells their rows apart."""


@dataclass(frozen=True)
class Results:
    """Runs, tests and curves, as rows of text by column.

    Attributes:
        runs: One row for each run, finished or failed.
        tests: One row for each run and condition.
        curves: One row for each run and evaluation during training.
    """

    runs: dict[str, Row]
    tests: dict[tuple[str, str], Row]
    curves: dict[str, list[Row]]

    def state(self, run: Run) -> str:
        """Return "finished", "failed" or "not run"."""
        return self.runs.get(run.name, {}).get("state", "not run")

    def score(self, run: Run, metric: str, condition: str) -> float | None:
        """Return a metric of a finished run's training, or of its test under a condition; None if there is none."""
        if self.state(run) != "finished":
            return None
        for row in (self.tests.get((run.name, condition), {}), self.runs[run.name]):
            if row.get(metric, "") != "":
                return float(row[metric])
        return None

    def curve(self, run: Run, metric: str) -> Curve | None:
        """Return the evaluations during the training of a run; None if there are none."""
        rows = [row for row in self.curves.get(run.name, []) if row.get(metric, "") != ""]
        if not rows or self.state(run) != "finished":
            return None
        return Curve(np.array([int(row["step"]) for row in rows]), np.array([float(row[metric]) for row in rows]))


def load_results(folder: Path) -> Results:
    """Read the three files of a folder; a missing one has no rows."""
    runs, tests, curves = (_read(folder / f"{name}.csv") for name in FILES)
    by_run: dict[str, list[Row]] = {}
    for row in curves:
        by_run.setdefault(row["run"], []).append(row)
    return Results({row["run"]: row for row in runs}, {(row["run"], row["condition"]): row for row in tests}, by_run)


def save_runs(folder: Path, runs: Iterable[tuple[str, Path, str]]) -> None:
    """Add runs, given as (name, folder, state), to the files of a folder, in place of what these say of them."""
    rows: dict[str, list[Row]] = {name: [] for name in FILES}
    for name, run_dir, state in runs:
        rows["runs"].append(run_row(name, run_dir, state))
        rows["tests"] += test_rows(name, run_dir)
        rows["curves"] += curve_rows(name, run_dir)
    names = {row["run"] for row in rows["runs"]}
    folder.mkdir(parents=True, exist_ok=True)
    for table, keys in FILES.items():
        path = folder / f"{table}.csv"
        kept = [row for row in _read(path) if row["run"] not in names]
        _write(path, kept + rows[table], keys)


def _read(path: Path) -> list[Row]:
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _write(path: Path, rows: Sequence[Row], keys: Sequence[str]) -> None:
    """Write rows sorted by their keys, columns in the order in which they first appear."""
    columns = list(dict.fromkeys(column for row in rows for column in row))
    temporary = path.with_suffix(".tmp")
    with temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: [_sortable(row[key]) for key in keys]))
    temporary.replace(path)


def _sortable(value: object) -> tuple[float, str]:
    text = str(value)
    return (float(text), "") if text.isdigit() else (-1.0, text)
