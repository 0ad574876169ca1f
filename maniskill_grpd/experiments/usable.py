"""What of the results may stand side by side: runs of one code, whole, finite and of the budget that they are named after."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from maniskill_grpd.experiments.fingerprints import Mark, Present, group, largest
from maniskill_grpd.experiments.records import Row
from maniskill_grpd.experiments.results import TEXT_COLUMNS, Results
from maniskill_grpd.experiments.study import Run, expert_run
from maniskill_grpd.runs.source import fingerprint_code

OTHER_CODE = "of other code than the rest"
NO_FINGERPRINT = "without a fingerprint"


@dataclass(frozen=True)
class Usable:
    """The part of the results that a page may show.

    Attributes:
        results: Without what is left out.
        left_out: Why, by name of the run, or of run and condition.
        code: Which code the results on a task are of, as a number, by name of the task.
        present: The number of the present code.
    """

    results: Results
    left_out: dict[str, str]
    code: dict[str, int | None]
    present: int | None


def choose(results: Results, runs: Mapping[str, Sequence[Run]], present: Present | None = None) -> Usable:
    """Leave out what must not be compared with the rest.

    On each task runs of the present code are preferred, else those of the code of which there are most. Tests are of the code of
    their run or left out.

    Args:
        results: All results.
        runs: Runs to be shown, by name of their task.
        present: What the present code says of a run, asked where its source is another one; None: such runs are older.
    """
    faults = {run.name: fault for found in runs.values() for run in found if (fault := _fault(results, run))}
    kept = {task: [run for run in found if run.name not in faults] for task, found in runs.items()}
    names = [run.name for found in kept.values() for run in found if results.state(run) == "finished"]
    names += [expert_run(found[0].task).name for found in kept.values() if found]
    tests = [key for key in results.tests if key[0] in set(names) and not results.tests[key].get("error")]
    marks = [Mark.of_run(results.runs[name]) if name in results.runs else Mark("", "", "") for name in names]
    marks += [Mark.of_test(results.tests[key]) for key in tests]
    numbers = group([*marks, Mark("", "", fingerprint_code()), *_present_marks(results, kept, present)])
    code_of = dict(zip([*names, *tests], numbers, strict=False))
    now = numbers[len(marks)]
    # What the present code says of a run is of the present code.
    for number in numbers[len(marks) + 1 :]:
        code_of = {key: now if found == number else found for key, found in code_of.items()}
    chosen: dict[str, int | None] = {}
    for task, found in kept.items():
        codes = [code_of.get(run.name) for run in found]
        chosen[task] = now if now in codes else largest(codes)
        faults |= _strangers(found, tests, code_of, chosen[task])
    return Usable(_without(results, faults), faults, chosen, now)


def _present_marks(results: Results, runs: Mapping[str, Sequence[Run]], present: Present | None) -> list[Mark]:
    """Ask what the present code says of every kind of run whose source is another one."""
    if present is None:
        return []
    finished = [run for found in runs.values() for run in found if results.state(run) == "finished"]
    older = [run for run in finished if results.runs[run.name].get("code") != fingerprint_code()]
    return list(dict.fromkeys(present(run) for run in older))


def _strangers(
    runs: Sequence[Run], tests: Iterable[tuple[str, str]], code_of: Mapping[object, int | None], chosen: int | None
) -> dict[str, str]:
    """Return the runs on a task, and the tests of the others, that are of other code than the chosen one."""
    found = {}
    for run in runs:
        if run.name in code_of and (chosen is None or code_of[run.name] != chosen):
            found[run.name] = OTHER_CODE if code_of[run.name] is not None else NO_FINGERPRINT
    names = {run.name for run in runs} | {expert_run(run.task).name for run in runs[:1]}
    for name, condition in tests:
        if name in names and name not in found and code_of[name, condition] != chosen:
            reason = OTHER_CODE if code_of[name, condition] is not None else NO_FINGERPRINT
            found[f"{name}, {condition}"] = reason
    return found


def _fault(results: Results, run: Run) -> str | None:
    """Return what is wrong with a finished run by itself, None if nothing is."""
    if results.state(run) != "finished":
        return None
    row = results.runs[run.name]
    trained = json.loads(row.get("config") or "{}").get("total_timesteps", run.budget)
    if trained != run.budget:
        return f"trained for {trained:,} steps, not {run.budget:,}"
    rows = [row, *(test for (name, _), test in results.tests.items() if name == run.name), *results.curves.get(run.name, [])]
    wrong = sorted({column for found in rows for column, value in found.items() if not _is_finite(column, value)})
    return f"not finite: {', '.join(wrong)}" if wrong else None


def _is_finite(column: str, value: object) -> bool:
    return column in TEXT_COLUMNS or value in ("", None) or math.isfinite(float(value))  # type: ignore[arg-type]


def _without(results: Results, left_out: Mapping[str, str]) -> Results:
    runs: dict[str, Row] = {name: row for name, row in results.runs.items() if name not in left_out}
    tests = {key: row for key, row in results.tests.items() if key[0] not in left_out and f"{key[0]}, {key[1]}" not in left_out}
    return Results(runs, tests, {name: rows for name, rows in results.curves.items() if name not in left_out})
