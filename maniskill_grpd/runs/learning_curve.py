"""The learning curve of a run, from its metrics.jsonl, or those of several runs together."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.runs.record import read_progress
from maniskill_grpd.tasks.measurement import Metric

LABELS = {"return": "return", "success_once": "success rate (once)", "success_at_end": "success rate (at the end)"}
"""Axis labels; other metrics are labelled by their names."""


def plot_learning_curve(run_dir: Path, path: Path | None = None, metrics: Sequence[str] | None = None) -> Path:
    """Plot the curve of one run, see `plot_learning_curves`; by default into learning_curve.png in its folder."""
    return plot_learning_curves([run_dir], path or run_dir / "learning_curve.png", metrics)


def plot_learning_curves(run_dirs: Sequence[Path], path: Path, metrics: Sequence[str] | None = None) -> Path:
    """Plot metrics of episodes over environment steps, in training (thin) and in evaluation (with dots).

    Args:
        run_dirs: Folders of runs, one colour each.
        path: The PNG to write.
        metrics: One panel each; by default return, success and the progress of the first run's task.

    Returns:
        The file that was written.

    Raises:
        ValueError: If a run has logged nothing, or not a metric that is asked for.
    """
    logs = {run_dir.name: read_rows(run_dir / "metrics.jsonl") for run_dir in run_dirs}
    for run_dir in run_dirs:
        if not logs[run_dir.name]:
            raise ValueError(f"{run_dir / 'metrics.jsonl'} holds no metrics")
    progress = read_progress(run_dirs[0])
    panels = [_choose_panels(rows, metrics, progress) for rows in logs.values()][0]
    labels = LABELS if progress is None else {progress.name: progress.label, **LABELS}
    figure = Figure(figsize=(4.2 * len(panels), 3.2), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)
    for axis, key in zip(axes[0], panels, strict=True):
        for index, (name, rows) in enumerate(logs.items()):
            axis.plot(*_series(rows, f"train/{key}"), color=f"C{index}", lw=1.0, alpha=0.6)
            axis.plot(*_series(rows, f"eval/{key}"), color=f"C{index}", lw=2.0, marker="o", ms=3, label=name)
        axis.set_xlabel("environment steps")
        axis.set_ylabel(labels.get(key, key))
        axis.grid(alpha=0.3)
    axes[0, 0].legend(fontsize=8)
    figure.savefig(path, dpi=150)
    return path


def _choose_panels(rows: list[dict[str, Any]], metrics: Sequence[str] | None, progress: Metric | None) -> list[str]:
    tags = set().union(*rows)
    found = {tag.partition("/")[2] for tag in tags if tag.startswith(("train/", "eval/"))}
    if metrics is None:
        wanted = ["return", "success_once", *([] if progress is None else [progress.name])]
        return [name for name in wanted if name in found] or ["return"]
    unknown = [name for name in metrics if name not in found]
    if unknown:
        raise ValueError(f"the run has not logged {', '.join(unknown)}; it has {', '.join(sorted(found))}")
    return list(metrics)


def _series(rows: list[dict[str, Any]], tag: str) -> tuple[list[int], list[float]]:
    found = [(row["global_step"], row[tag]) for row in rows if tag in row]
    return [step for step, _ in found], [value for _, value in found]
