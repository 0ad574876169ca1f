"""Which runs and tests are of the same code, by what their fingerprints say (see `runs.fingerprint`)."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from maniskill_grpd.experiments.records import Row
from maniskill_grpd.experiments.study import Run

SEEDED = ("seed", "exp_name")
"""Options of a training that its fingerprint does not depend on."""


@dataclass(frozen=True)
class Mark:
    """What the fingerprint of a run or test says.

    Attributes:
        subject: What was fingerprinted: task and learner with their options, seeds left out.
        behaviour: Hashes of what that did; empty if unknown.
        code: Hash of the source; empty if unknown.
    """

    subject: str
    behaviour: str
    code: str

    @classmethod
    def of_run(cls, row: Row) -> Mark:
        """Return the mark of a row of runs."""
        config = json.loads(row.get("config") or "{}")
        subject = {key: value for key, value in config.items() if key not in SEEDED}
        return cls(json.dumps(subject, sort_keys=True), _joined(row, "solver", "task", "learner"), row.get("code", ""))

    @classmethod
    def of_test(cls, row: Row) -> Mark:
        """Return the mark of a row of tests, whose task is that of the run under its conditions."""
        env_id = row["run"].partition("__")[0].partition(",")[0]
        return cls(f"{env_id} {row.get('env_kwargs', '')}", _joined(row, "solver", "task"), row.get("code", ""))


def group(marks: Sequence[Mark]) -> list[int | None]:
    """Number the marks so that those of the same code have the same number; None for one without a fingerprint.

    Two marks are of the same code if their source is, or if the same subject did the same; and so are two that are both of the
    same code as a third.
    """
    names: dict[tuple[str, ...], int] = {}
    parents: list[int] = []

    def find(node: int) -> int:
        return node if parents[node] == node else find(parents[node])

    nodes = []
    for mark in marks:
        keys = [("code", mark.code)] if mark.code else []
        keys += [("behaviour", mark.subject, mark.behaviour)] if mark.behaviour else []
        for key in keys:
            if key not in names:
                names[key] = len(parents)
                parents.append(names[key])
        for key in keys[1:]:
            parents[find(names[key])] = find(names[keys[0]])
        nodes.append(names[keys[0]] if keys else None)
    return [None if node is None else find(node) for node in nodes]


Present = Callable[[Run], Mark]
"""What the present code says of a run."""


def _joined(row: Row, *parts: str) -> str:
    found = [row.get(part, "") for part in parts]
    return " ".join(found) if all(found) else ""


def largest(groups: Iterable[int | None]) -> int | None:
    """Return the number that comes most often, the first of several; None if there is none."""
    known = [number for number in groups if number is not None]
    return max(dict.fromkeys(known), key=known.count, default=None)
