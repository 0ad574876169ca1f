"""Markdown tables of a study."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from maniskill_grpd.experiments.claim import Claim, Finding
from maniskill_grpd.experiments.metrics import METRICS
from maniskill_grpd.experiments.study import AS_TRAINED, EXPERT, Arm, Task
from maniskill_grpd.experiments.study_data import StudyData, Summary, conditions_of, summarize

NOT_RUN = "not run"
FAILED = "failed"


def score_table(data: StudyData, metric: str) -> str:
    """Return a table of one metric: a row for each task and condition, a column for each arm.

    Cells hold the mean over seeds and its 95 % interval, of fewer than ten its smallest and largest, "not run" or "failed". If
    every arm has been run on every one of several tasks, a last row has the mean over tasks as trained. A last column has the
    expert, where it has been played.
    """
    arms = data.study.arms
    rows = [["task", "condition", "steps", "seeds", *(arm.name for arm in arms)]]
    for task in data.study.tasks:
        for condition in conditions_of(task):
            cells = [score_cell(data, task, arm, condition.name, metric) for arm in arms]
            rows.append([task.name, condition.name, _budget(data, task), _seeds(data, task, condition.name, metric), *cells])
    pooled = [data.pooled(arm, metric) for arm in arms]
    if len(data.study.tasks) > 1 and all(pooled) and not METRICS[metric].is_time:
        cells = [format_summary(summarize(strata), METRICS[metric].decimals) for strata in pooled]
        rows.append(["all tasks", AS_TRAINED.name, "", "", *cells])
    return markdown_table(_with_experts(data, metric, rows), num_text_columns=2)


def _with_experts(data: StudyData, metric: str, rows: list[list[str]]) -> list[list[str]]:
    """Return rows with a column for the experts, if any has been played; they are as trained only."""
    scores = {task.name: data.expert(task, metric) for task in data.study.tasks}
    if all(score is None for score in scores.values()):
        return rows
    columns = [EXPERT.name]
    for task, condition, *_ in rows[1:]:
        score = scores.get(task) if condition == AS_TRAINED.name else None
        columns.append("-" if score is None else f"{score:.{METRICS[metric].decimals}f}")
    return [[*row, cell] for row, cell in zip(rows, columns, strict=True)]


def score_cell(data: StudyData, task: Task, arm: Arm, condition: str, metric: str) -> str:
    """Return the text of one cell."""
    summary = data.summary(task, arm, condition, metric)
    if summary is not None:
        return format_summary(summary, METRICS[metric].decimals)
    return FAILED if data.has_failed(task, arm, condition) else NOT_RUN


def claim_table(findings: Iterable[tuple[Claim, Finding]]) -> str:
    """Return a table that sets the paper's figures beside ours."""
    rows = [["claim", "on", "paper", "figure there", "here", "95 % interval", "IQM", "g", "P(better)", "seeds", "p", "verdict"]]
    for claim, finding in findings:
        tasks = dict.fromkeys(side.task or "all tasks" for side in (claim.ours, claim.theirs))
        rows.append([claim.text, " against ".join(tasks), claim.source, claim.paper, *_finding_cells(claim, finding)])
    return markdown_table(rows, num_text_columns=3)


def _finding_cells(claim: Claim, finding: Finding) -> list[str]:
    if finding.verdict == "not run":
        return ["-", "-", "-", "-", "-", "0", "-", NOT_RUN]
    low, high = finding.interval
    interval = f"{claim.format(low)} to {claim.format(high)}" if np.isfinite([low, high]).all() else "-"
    return [
        claim.format(finding.value),
        interval,
        claim.format(finding.middle),
        f"{finding.effect:+.1f}" if np.isfinite(finding.effect) else "-",
        f"{finding.better:.2f}" if claim.measure in ("gain", "difference") else "-",
        str(finding.num_runs),
        "-" if np.isnan(finding.p_value) else f"{finding.p_value:.3f}",
        finding.verdict,
    ]


def format_summary(summary: Summary | None, decimals: int) -> str:
    """Return "mean [low, high]", or "mean (smallest-largest)" of too few runs for an interval."""
    if summary is None:
        return NOT_RUN
    text = f"{summary.mean:.{decimals}f}"
    low, high = summary.interval
    if np.isfinite([low, high]).all():
        return f"{text} [{low:.{decimals}f}, {high:.{decimals}f}]"
    smallest, largest = summary.extremes
    return text if not largest > smallest else f"{text} ({smallest:.{decimals}f}-{largest:.{decimals}f})"


def markdown_table(rows: Sequence[Sequence[str]], num_text_columns: int) -> str:
    """Return rows, the first of which is the head, as a Markdown table; columns after the first few are aligned right."""
    alignment = ["---" if column < num_text_columns else "--:" for column in range(len(rows[0]))]
    return "\n".join("| " + " | ".join(row) + " |" for row in [rows[0], alignment, *rows[1:]])


def _budget(data: StudyData, task: Task) -> str:
    budget = data.budget(task)
    return NOT_RUN if budget is None else f"{budget:,}"


def _seeds(data: StudyData, task: Task, condition: str, metric: str) -> str:
    low, high = data.seeds(task, condition, metric)
    return str(low) if low == high else f"{low} to {high}"
