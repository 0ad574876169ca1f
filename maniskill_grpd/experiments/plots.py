"""Pictures of a study, all in one style: an arm has the same colour everywhere, a band or line is an interval, a point a run.

A dashed line is the scripted expert on the task of the training.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, LogLocator, NullFormatter

from maniskill_grpd.experiments.curves import efficiency_band
from maniskill_grpd.experiments.metrics import METRICS
from maniskill_grpd.experiments.statistics import performance_profile
from maniskill_grpd.experiments.study import EXPERT, Arm, Condition, Task
from maniskill_grpd.experiments.study_data import StudyData, Summary, conditions_of

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000", "#999999", "#f0e442", "#882255")
"""Okabe and Ito's colours, which people with colour blindness can tell apart, and two more, in the order of a study's arms."""
PANEL_SIZE = (3.6, 2.9)
"""Width and height of one panel [inch]."""
PROFILE_THRESHOLDS = np.linspace(0.0, 1.0, 101)


def plot_bars(data: StudyData) -> Figure | None:
    """Draw the first metric: a panel for each task, a group of bars for each condition, a bar for each arm."""
    metric, study = data.study.metrics[0], data.study
    tasks = [task for task in study.tasks if data.runs(task)]
    if not tasks:
        return None
    figure, axes = _panels(len(tasks))
    width = 0.8 / len(study.arms)
    for axis, task in zip(axes, tasks, strict=True):
        names = [condition.name for condition in conditions_of(task)]
        for index, arm in enumerate(study.arms):
            places = np.arange(len(names)) + (index - (len(study.arms) - 1) / 2) * width
            middles, lows, highs = _summaries(data, task, arm, names, metric).T
            axis.bar(places, middles, width, color=COLORS[index], label=arm.name)
            axis.vlines(places, lows, highs, color="black", lw=1.0)
            for place, name in zip(places, names, strict=True):
                points = list(data.scores(task, arm, name, metric).values())
                axis.plot([place] * len(points), points, ls="", marker=".", ms=3, color="0.2")
        _draw_expert(axis, data, task, metric)
        axis.set_xlim(-0.5, len(names) - 0.5)  # also where some arms have not been run
        axis.set_xticks(range(len(names)), names, **({"rotation": 20, "ha": "right"} if len(names) > 1 else {}))
        _finish(axis, task.name, "", metric)
    return _with_legend(figure)


def plot_curves(data: StudyData) -> Figure | None:
    """Draw the evaluations during training: a panel for each task, success above, return below."""
    return _draw_curves(data, ("success_at_end", "return"))


def plot_action_norms(data: StudyData) -> Figure | None:
    """Draw the length of actions during training: a panel for each task."""
    return _draw_curves(data, ("action_norm",))


def _draw_curves(data: StudyData, metrics: Sequence[str]) -> Figure | None:
    """Draw metrics over training: a row of panels for each, a column for each task that has them."""
    study = data.study
    tasks = [task for task in study.tasks if any(data.curves(task, arm, metrics[-1]) for arm in study.arms)]
    if not tasks:
        return None
    figure, axes = _panels(len(metrics) * len(tasks), columns=len(tasks))
    for row, metric in enumerate(metrics):
        for axis, task in zip(axes[row * len(tasks) :], tasks, strict=False):
            for index, arm in enumerate(study.arms):
                _draw_band(axis, data, task, arm, metric, COLORS[index])
            _draw_expert(axis, data, task, metric)
            axis.xaxis.set_major_formatter(EngFormatter(sep=""))  # 50k, 1M
            _finish(axis, task.name if row == 0 else "", "environment steps", metric)
    return _with_legend(figure)


def plot_profile(data: StudyData) -> Figure | None:
    """Draw the performance profile over all tasks: share of runs whose success exceeds a threshold."""
    figure, (axis,) = _panels(1)
    for index, arm in enumerate(data.study.arms):
        strata = data.pooled(arm, "success_at_end")
        if strata is not None:
            shares = performance_profile(strata, PROFILE_THRESHOLDS)
            axis.plot(PROFILE_THRESHOLDS, shares, color=COLORS[index], label=arm.name, drawstyle="steps-post")
    if not axis.lines:
        return None
    axis.set_ylim(-0.02, 1.02)
    _finish(axis, "all tasks", "success > threshold", "success_at_end")
    axis.set_ylabel("share of runs")
    return _with_legend(figure)


def plot_lines(data: StudyData) -> Figure | None:
    """Draw the first metric over the study's factor: a panel for each task id, a line for each arm."""
    study, metric = data.study, data.study.metrics[0]
    env_ids = [env_id for env_id in dict.fromkeys(task.env_id for task in study.tasks) if _points(data, env_id)]
    if not env_ids:
        return None
    figure, axes = _panels(len(env_ids))
    for axis, env_id in zip(axes, env_ids, strict=True):
        points = _points(data, env_id)
        values = [task.factor(study.factor, condition) for task, condition in points]
        is_numeric = all(isinstance(value, (int, float)) for value in values)
        places = values if is_numeric else list(range(len(values)))
        for index, arm in enumerate(study.arms):
            summaries = [data.summary(task, arm, condition.name, metric) for task, condition in points]
            _draw_line(axis, places, summaries, COLORS[index], arm.name)
        _draw_expert(axis, data, points[0][0], metric)
        axis.set_xticks(places, [f"{value}" for value in values], rotation=30)
        _finish(axis, env_id, study.factor, metric)
    return _with_legend(figure)


def plot_heat_map(data: StudyData) -> Figure | None:
    """Draw the first metric over noise and resolution: a row of panels for each task, a panel for each arm."""
    study, metric = data.study, data.study.metrics[0]
    tasks = [task for task in study.tasks if data.runs(task)]
    if not tasks:
        return None
    figure, axes = _panels(len(tasks) * len(study.arms), columns=len(study.arms))
    pairs = [(task, arm) for task in tasks for arm in study.arms]
    for axis, (task, arm) in zip(axes, pairs, strict=True):
        sigmas, resolutions = (_levels(task, factor) for factor in ("sigma", "resolution"))
        image = np.full((len(resolutions), len(sigmas)), np.nan)
        for condition in conditions_of(task):
            summary = data.summary(task, arm, condition.name, metric)
            place = resolutions.index(task.factor("resolution", condition)), sigmas.index(task.factor("sigma", condition))
            image[place] = np.nan if summary is None else summary.mean
        _draw_image(axis, image)
        axis.set_xticks(range(len(sigmas)), [f"{sigma:g}" for sigma in sigmas])
        axis.set_yticks(range(len(resolutions)), [str(num) for num in resolutions])
        axis.set(title=f"{task.env_id}, {arm.name}", xlabel="sigma [m], [m/s]", ylabel="nodes")
        axis.title.set_size(8)
    figure.suptitle(METRICS[metric].label, fontsize=9)
    return figure


PLOTS: dict[str, Callable[[StudyData], Figure | None]] = {
    "bars": plot_bars,
    "curves": plot_curves,
    "action_norms": plot_action_norms,
    "profile": plot_profile,
    "lines": plot_lines,
    "heat_map": plot_heat_map,
}
"""Pictures by the names that studies use; None where there is nothing to draw."""


def _summaries(data: StudyData, task: Task, arm: Arm, conditions: Sequence[str], metric: str) -> np.ndarray:
    """Return mean, low and high end of each condition (C, 3), nan where nothing has been run."""
    table = np.full((len(conditions), 3), np.nan)
    for row, condition in zip(table, conditions, strict=True):
        summary = data.summary(task, arm, condition, metric)
        if summary is not None:
            row[0], row[1:] = summary.mean, summary.interval
    return table


def _draw_band(axis: Axes, data: StudyData, task: Task, arm: Arm, metric: str, color: str) -> None:
    curves = data.curves(task, arm, metric)
    if not curves:
        return
    band = efficiency_band(curves)
    axis.plot(band.steps, band.middle, color=color, label=arm.name)
    axis.fill_between(band.steps, band.low, band.high, color=color, alpha=0.2, lw=0)


def _draw_expert(axis: Axes, data: StudyData, task: Task, metric: str) -> None:
    score = data.expert(task, metric)
    if score is not None:
        axis.axhline(score, color="0.4", ls="--", lw=1.0, label=EXPERT.name)


def _draw_line(axis: Axes, places: Sequence[float], summaries: Sequence[Summary | None], color: str, label: str) -> None:
    found = [(place, *summary[:2]) for place, summary in zip(places, summaries, strict=True) if summary is not None]
    if not found:
        return
    x, y, intervals = (np.array(column) for column in zip(*found, strict=True))
    axis.plot(x, y, color=color, marker="o", ms=3, label=label)
    axis.fill_between(x, *intervals.T, color=color, alpha=0.2, lw=0)


def _draw_image(axis: Axes, image: np.ndarray) -> None:
    axis.imshow(image, vmin=0.0, vmax=1.0, cmap="viridis", aspect="auto", origin="lower")
    for (row, column), value in np.ndenumerate(image):
        text = "not run" if np.isnan(value) else f"{value:.2f}"
        axis.text(column, row, text, ha="center", va="center", fontsize=6, color="white" if value < 0.6 else "black")


def _points(data: StudyData, env_id: str) -> list[tuple[Task, Condition]]:
    """Return what lies along the abscissa: conditions that differ in nothing but the factor, in its order if it is a number."""
    factor = data.study.factor
    tasks = [task for task in data.study.tasks if task.env_id == env_id and data.runs(task)]
    points = [(task, c) for task in tasks for c in conditions_of(task) if not c.factors or set(c.factors) == {factor}]
    if all(isinstance(task.factor(factor, condition), str) for task, condition in points):
        return points
    return sorted(points, key=lambda point: point[0].factor(factor, point[1]))


def _levels(task: Task, factor: str) -> list[Any]:
    return sorted({task.factor(factor, condition) for condition in conditions_of(task)})


def _panels(number: int, columns: int | None = None) -> tuple[Figure, list[Axes]]:
    """Return a figure without a window, and its panels row by row."""
    columns = columns or min(number, 4)
    rows = math.ceil(number / columns)
    figure = Figure(figsize=(PANEL_SIZE[0] * columns, PANEL_SIZE[1] * rows + 0.4), layout="constrained", dpi=110)
    FigureCanvasAgg(figure)
    return figure, [figure.add_subplot(rows, columns, index + 1) for index in range(number)]


def _finish(axis: Axes, title: str, xlabel: str, metric: str) -> None:
    axis.set_title(title, fontsize=9)
    axis.set_xlabel(xlabel, fontsize=8)
    axis.set_ylabel(METRICS[metric].label, fontsize=8)
    axis.tick_params(labelsize=7)
    axis.grid(alpha=0.3)
    axis.spines[["top", "right"]].set_visible(False)
    if METRICS[metric].is_time:
        axis.set_yscale("log")
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter("{x:g}")
        axis.yaxis.set_minor_formatter(NullFormatter())


def _with_legend(figure: Figure) -> Figure:
    """Name what is drawn in any of the panels, once, below them."""
    handles_of: dict[str, Any] = {}
    for axis in figure.axes:
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            handles_of.setdefault(label, handle)
    labels, handles = list(handles_of), list(handles_of.values())
    columns = min(len(labels), int(figure.get_figwidth() / 1.2))  # a name takes a bit more than an inch
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=8, frameon=False)
    return figure
