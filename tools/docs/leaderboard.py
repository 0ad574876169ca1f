"""docs/leaderboard.md: what learners reach, from a file for each result (docs/leaderboard/*.json) and the tests of experts."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

Z = 1.959964
"""Quantile of the normal distribution for an interval of 95 %."""
FIELDS: dict[str, tuple[type, ...]] = {
    "task": (str,),
    "options": (dict,),
    "learner": (str,),
    "num_seeds": (int,),
    "num_episodes": (int,),
    "num_successes": (int,),
    "steps": (int, type(None)),
    "hours": (int, float, type(None)),
    "hardware": (str,),
    "version": (str,),
    "command": (str,),
}
"""What a result says, and the types of it; None is what was not recorded."""

INTRODUCTION = """# Leaderboard

Success at the end of episodes, in the mean over trainings, on seeds from 1,000,000 up. The interval is Wilson's at 95 % over
episodes: it tells how well *these* policies were tested, not how another training would end; for that compare ten seeds
([experiments](experiments.md)). Rows of one task with the same options can be compared. `make docs` writes this page from
docs/leaderboard/*.json, and the rows of the experts from benchmarks/tasks.json.
"""
HAND_IN = """## Handing a result in

1. Train with the task's options at their defaults, or name those that differ. Steps are environment steps over all worlds;
   demonstrations and tuning belong to the story: say so in `learner`.
2. Test every training with `maniskill-grpd evaluate --checkpoint FILE --num_episodes 200`, or your learner on the same seeds,
   1,000,000 to 1,000,199. The last checkpoint counts, not the best of the test.
3. Add one file docs/leaderboard/NAME.json with these fields and run `python -m tools.docs`:

```json
{example}
```

`num_episodes` and `num_successes` are sums over the trainings. `steps` and `hours`, of one training, are null where they are not
known. `version` is that of this package, with the commit where it is not a release; `command` repeats the test.
"""


class ResultError(ValueError):
    """A file is not a result."""


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return the results of a folder.

    Raises:
        ResultError: Naming the file, and the field that is missing or wrong.
    """
    results = []
    for path in sorted(folder.glob("*.json")):
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
        except json.JSONDecodeError as error:
            raise ResultError(f"{path.name} is no JSON: {error}") from None
        _check(result, path.name)
        results.append(result)
    return results


def leaderboard_page(results: Iterable[Mapping[str, Any]], benchmarks: Iterable[Mapping[str, Any]]) -> str:
    """Return the page.

    Args:
        results: What `read_results` returned.
        benchmarks: Rows of benchmarks/tasks.json, of which experts with default options are shown.
    """
    rows = [*results, *(_of_expert(row) for row in benchmarks if row.get("policy") == "expert" and not row["options"])]
    parts = [INTRODUCTION]
    for task in sorted({row["task"] for row in rows}):
        table = sorted((row for row in rows if row["task"] == task), key=lambda row: -row["num_successes"] / row["num_episodes"])
        parts.append(f"## {task}\n\n{HEAD}\n" + "\n".join(_line(row) for row in table) + "\n")
    example = json.dumps(next(iter(results)), indent=2)
    return "\n".join([*parts, HAND_IN.format(example=example)])


HEAD = """| learner | options | success | 95 % interval | episodes | trainings | steps | hours | hardware | version |
|---|---|--:|--:|--:|--:|--:|--:|---|---|"""


def wilson_interval(successes: int, trials: int) -> tuple[float, float]:
    """Return the interval of a rate at 95 % (Wilson 1927)."""
    rate, weight = successes / trials, Z**2 / trials
    middle = (rate + weight / 2.0) / (1.0 + weight)
    half = Z / (1.0 + weight) * (rate * (1.0 - rate) / trials + weight / (4.0 * trials)) ** 0.5
    return max(0.0, middle - half), min(1.0, middle + half)


def _line(row: Mapping[str, Any]) -> str:
    low, high = wilson_interval(row["num_successes"], row["num_episodes"])
    options = " ".join(f"`{key}={json.dumps(value)}`" for key, value in row["options"].items()) or "defaults"
    steps = "-" if row["steps"] is None else f"{row['steps']:,}"
    hours = "-" if row["hours"] is None else f"{row['hours']:.1f}"
    numbers = [f"{row['num_successes'] / row['num_episodes']:.3f}", f"{low:.3f} to {high:.3f}", str(row["num_episodes"])]
    cells = [row["learner"], options, *numbers, str(row["num_seeds"] or "-"), steps, hours, row["hardware"], row["version"]]
    return f"| {' | '.join(cells)} |"


def _of_expert(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row about an expert in the form of a result."""
    successes = round(row["success_at_end"] * row["num_episodes"])
    shared = {"steps": None, "hours": None, "num_seeds": 0, "version": "-", "options": {}}
    told = {"task": row["env"], "num_episodes": row["num_episodes"], "num_successes": successes}
    return {"learner": "*scripted expert*", "hardware": row["machine"]["cpu"], **shared, **told}


def _check(result: Any, name: str) -> None:
    if not isinstance(result, dict) or set(result) != set(FIELDS):
        raise ResultError(f"{name} must have the fields {', '.join(FIELDS)}")
    for field, types in FIELDS.items():
        if not isinstance(result[field], types) or isinstance(result[field], bool):
            raise ResultError(f"{name}: {field} is {result[field]!r}, which is of another type than it has to be")
    if not 0 <= result["num_successes"] <= result["num_episodes"] or result["num_episodes"] == 0 or result["num_seeds"] < 1:
        counts = ", ".join(f"{field} = {result[field]}" for field in ("num_seeds", "num_episodes", "num_successes"))
        raise ResultError(f"{name}: {counts} cannot be")
