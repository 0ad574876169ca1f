"""The part of the results that answers a study."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from maniskill_grpd.experiments.claim import MIN_RUNS, NOT_RUN, Claim, Finding, Side, decide, examine
from maniskill_grpd.experiments.curves import Curve
from maniskill_grpd.experiments.fingerprints import Present
from maniskill_grpd.experiments.results import Results
from maniskill_grpd.experiments.statistics import UNKNOWN, Interval, estimate
from maniskill_grpd.experiments.study import AS_TRAINED_NAME, Arm, Condition, Run, Study, Task, expert_run
from maniskill_grpd.experiments.usable import choose


class Summary(NamedTuple):
    """Scores of several runs.

    Attributes:
        mean: Their mean.
        interval: Its 95 % interval; nan below `MIN_RUNS` runs.
        extremes: The smallest and the largest score; nan over several tasks.
    """

    mean: float
    interval: Interval
    extremes: tuple[float, float]


class StudyData:
    """Scores of a study.

    Per task only runs of one budget and of one code are compared: the given budget, or else the largest that has been run.

    Args:
        study: The study.
        results: All results.
        budget: Environment steps of the runs; None: the largest there are.
        present: What the present code says of a run; see `choose`.
    """

    def __init__(self, study: Study, results: Results, budget: int | None = None, present: Present | None = None) -> None:
        self.study = study
        self.results = results
        budgets = [study.budget or budget] if study.budget or budget else _distinct(results, "budget")[::-1]
        seeds = [seed for seed in _distinct(results, "seed") if study.shows(seed)]
        found = {task.name: self._find_runs(task, budgets, seeds) for task in study.tasks}
        self._usable = choose(results, found, present)
        self.results = self._usable.results
        self._runs = {name: [run for run in runs if run.name in self.results.runs] for name, runs in found.items()}

    @property
    def left_out(self) -> dict[str, str]:
        """Runs and tests that must not be compared with the others, and why."""
        return self._usable.left_out

    def is_older(self, task: Task) -> bool:
        """Return whether the runs on a task are of older code than the present one."""
        return bool(self.runs(task)) and self._usable.code[task.name] != self._usable.present

    def runs(self, task: Task) -> list[Run]:
        """Return the runs on a task that are in the results, finished or failed."""
        return self._runs[task.name]

    def _find_runs(self, task: Task, budgets: Sequence[int], seeds: Sequence[int]) -> list[Run]:
        """Return the runs of the first of several budgets that has any."""
        for budget in budgets:
            found = [run for run in self.study.runs(budget, seeds) if run.task == task and run.name in self.results.runs]
            if found:
                return found
        return []

    def budget(self, task: Task) -> int | None:
        """Return the environment steps of the runs on a task; None if there are none."""
        runs = self.runs(task)
        return runs[0].budget if runs else None

    def seeds(self, task: Task, condition: str, metric: str) -> tuple[int, int]:
        """Return the smallest and the largest number of seeds of an arm that have a score on a task under a condition."""
        counts = [len(self.scores(task, arm, condition, metric)) for arm in self.study.arms]
        return min(counts), max(counts)

    def finished(self, task: Task, arm: Arm) -> list[Run]:
        """Return the finished runs of an arm on a task, by seed."""
        return [run for run in self.runs(task) if run.arm == arm and self.results.state(run) == "finished"]

    def has_failed(self, task: Task, arm: Arm, condition: str) -> bool:
        """Return whether a run of the arm on the task has failed, or its test under the condition."""
        runs = [run for run in self.runs(task) if run.arm == arm]
        tests = [self.results.tests.get((run.name, condition), {}) for run in runs]
        return any(self.results.state(run) == "failed" for run in runs) or any(test.get("error") for test in tests)

    def scores(self, task: Task, arm: Arm, condition: str, metric: str) -> dict[int, float]:
        """Return the score of each finished run under a condition, by seed."""
        values = {run.seed: self.results.score(run, metric, condition) for run in self.finished(task, arm)}
        return {seed: value for seed, value in values.items() if value is not None}

    def curves(self, task: Task, arm: Arm, metric: str) -> list[Curve]:
        """Return the learning curves of the finished runs of an arm on a task."""
        curves = [self.results.curve(run, metric) for run in self.finished(task, arm)]
        return [curve for curve in curves if curve is not None]

    def summary(self, task: Task, arm: Arm, condition: str, metric: str) -> Summary | None:
        """Return the mean over seeds and its interval; None if nothing has been run."""
        return summarize([np.array(list(self.scores(task, arm, condition, metric).values()))])

    def expert(self, task: Task, metric: str) -> float | None:
        """Return the score of the scripted expert on a task; None if it has not been played."""
        return self.results.score(expert_run(task), metric, AS_TRAINED_NAME)

    def pooled(self, arm: Arm, metric: str) -> list[np.ndarray] | None:
        """Return the scores of an arm under the first condition of every task; None if a task is missing."""
        strata = [self.scores(task, arm, first_condition(task), metric) for task in self.study.tasks]
        return [np.array(list(scores.values())) for scores in strata] if all(strata) else None

    def findings(self) -> list[tuple[Claim, Finding]]:
        """Compare all claims of the study with the data, and decide them together."""
        claims = self.study.claims
        return list(zip(claims, decide([self._finding(claim) for claim in claims]), strict=True))

    def _finding(self, claim: Claim) -> Finding:
        """Compare a claim with the data; sides of different code are not compared."""
        if len({self._usable.code[task.name] for side in (claim.ours, claim.theirs) for task in self._tasks(side)}) > 1:
            return NOT_RUN
        ours, theirs = self._side(claim.ours, claim.metric), self._side(claim.theirs, claim.metric)
        if ours is None or theirs is None:
            return NOT_RUN
        if claim.is_paired:
            both = [sorted(x.keys() & y.keys()) for x, y in zip(ours, theirs, strict=True)]
            ours, theirs = ([{s: x[s] for s in seeds} for x, seeds in zip(side, both, strict=True)] for side in (ours, theirs))
        arrays = [[np.array(list(scores.values())) for scores in side] for side in (ours, theirs)]
        if not all(len(runs) for side in arrays for runs in side):
            return NOT_RUN
        return examine(claim, *arrays)

    def _tasks(self, side: Side) -> list[Task]:
        return [task for task in self.study.tasks if side.task in (None, task.name)]

    def _side(self, side: Side, metric: str) -> list[dict[int, float]] | None:
        """Return the scores by seed on each task of a side, averaged over its conditions; None if some are missing."""
        (arm,) = (arm for arm in self.study.arms if arm.name == side.arm)
        strata = [self._mean_scores(task, arm, side.conditions or (first_condition(task),), metric) for task in self._tasks(side)]
        return strata if all(strata) else None

    def _mean_scores(self, task: Task, arm: Arm, conditions: Sequence[str], metric: str) -> dict[int, float]:
        tests = [self.scores(task, arm, condition, metric) for condition in conditions]
        seeds = sorted(set.intersection(*(set(scores) for scores in tests)))
        return {seed: float(np.mean([scores[seed] for scores in tests])) for seed in seeds}


def first_condition(task: Task) -> str:
    """Return the name of the condition that a task is tested under where nothing else is said."""
    return task.conditions[0].name if task.conditions else AS_TRAINED_NAME


def conditions_of(task: Task) -> tuple[Condition, ...]:
    """Return the conditions of a task; one, as trained, for a task that is not tested at all."""
    return task.conditions or (Condition(),)


def summarize(strata: Sequence[np.ndarray]) -> Summary | None:
    """Return the mean of scores (R,) of each task and its interval, unknown below `MIN_RUNS` runs; None if a task has none."""
    if not all(len(stratum) for stratum in strata):
        return None
    found = estimate(strata)
    is_enough = min(map(len, strata)) >= MIN_RUNS
    extremes = (float(strata[0].min()), float(strata[0].max())) if len(strata) == 1 else UNKNOWN
    return Summary(found.value, found.interval() if is_enough else UNKNOWN, extremes)


def _distinct(results: Results, column: str) -> list[int]:
    return sorted({int(row[column]) for row in results.runs.values() if row.get(column)})
