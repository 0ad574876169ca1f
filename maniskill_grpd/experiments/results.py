"""The data behind all tables: three tidy CSV files of runs, of their tests and of their learning curves."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from maniskill_grpd.experiments.curves import Curve
from maniskill_grpd.experiments.records import FINGERPRINT, Row, curve_rows, run_row, test_rows
from maniskill_grpd.experiments.study import Run

FILES = {"runs": ("run",), "tests": ("run", "condition"), "curves": ("run", "step")}
"""Tables and what tells their rows apart."""

STATES = ("finished", "failed")
IDENTITY = {"run", "state", "env_id", "policy", "algorithm", "config", "condition", "env_kwargs", "error"}
MACHINE = {"device", "device_name", "python", "versions", "commit", "dirty"}
TEXT_COLUMNS = IDENTITY | MACHINE | set(FINGERPRINT)
"""Columns of any table that hold text; all others hold a number or nothing."""


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
    """Read the three files of a folder; a missing one has no rows.

    Raises:
        ValueError: If one is damaged, naming file and line.
    """
    runs, tests, curves = (_read(folder / f"{name}.csv", keys) for name, keys in FILES.items())
    by_run: dict[str, list[Row]] = {}
    for row in curves:
        by_run.setdefault(row["run"], []).append(row)
    return Results({row["run"]: row for row in runs}, {(row["run"], row["condition"]): row for row in tests}, by_run)


def save_runs(folder: Path, runs: Iterable[tuple[str, Path, str]]) -> None:
    """Add runs, given as (name, folder, state), to the files of a folder, in place of what these say of them.

    Raises:
        ValueError: If a file is damaged, naming file and line; nothing is written then.
    """
    rows: dict[str, list[Row]] = {name: [] for name in FILES}
    for name, run_dir, state in runs:
        rows["runs"].append(run_row(name, run_dir, state))
        rows["tests"] += test_rows(name, run_dir)
        rows["curves"] += curve_rows(name, run_dir)
    names = {row["run"] for row in rows["runs"]}
    kept = {table: _read(folder / f"{table}.csv", keys) for table, keys in FILES.items()}
    folder.mkdir(parents=True, exist_ok=True)
    for table, keys in FILES.items():
        others = [row for row in kept[table] if row["run"] not in names]
        _write(folder / f"{table}.csv", others + rows[table], keys)


def _read(path: Path, keys: Sequence[str]) -> list[Row]:
    """Read the rows of a table.

    Raises:
        ValueError: If the file is damaged, naming file and line.
    """
    if not path.exists():
        return []
    rows: dict[tuple[str, ...], Row] = {}
    with path.open(encoding="utf-8", newline="") as file:
        reader = csv.DictReader(file, strict=True)
        try:
            missing = [key for key in keys if key not in (reader.fieldnames or ())]
            if missing:
                raise ValueError(f"no column {', '.join(missing)}")
            for row in reader:
                _check_row(row, len(reader.fieldnames))
                identity = tuple(row[key] for key in keys)
                if identity in rows:
                    raise ValueError(f"a second row of {', '.join(identity)}")
                rows[identity] = row
        except csv.Error as error:  # in the row after the last one that could be read
            raise ValueError(f"{path}, line {reader.line_num + 1}: {error}") from error
        except ValueError as error:
            raise ValueError(f"{path}, line {max(1, reader.line_num)}: {error}") from error
    return list(rows.values())


def _check_row(row: Row, num_columns: int) -> None:
    """Refuse a row of another length than the head, or with text for a number."""
    if None in row or None in row.values():
        num_fields = sum(value is not None for key, value in row.items() if key is not None) + len(row.get(None, ()))
        raise ValueError(f"{num_fields} fields, where the head has {num_columns}")
    if row.get("state", STATES[0]) not in STATES:
        raise ValueError(f"state must be {' or '.join(STATES)}, got {row['state']!r}")
    for column, text in row.items():
        if column not in TEXT_COLUMNS and text != "":
            try:
                float(text)
            except ValueError:
                raise ValueError(f"{column} must be a number, got {text!r}") from None


def _write(path: Path, rows: Sequence[Row], keys: Sequence[str]) -> None:
    """Write rows sorted by their keys, columns in the order in which they first appear, keys first."""
    columns = list(dict.fromkeys([*keys, *(column for row in rows for column in row)]))
    temporary = path.with_suffix(".tmp")
    with temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(sorted(rows, key=lambda row: [_sortable(row[key]) for key in keys]))
    temporary.replace(path)


def _sortable(value: object) -> tuple[float, str]:
    text = str(value)
    return (float(text), "") if text.isdigit() else (-1.0, text)
