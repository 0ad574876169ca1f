"""Draw the learning curve of a run from its metrics.jsonl: python baselines/plot_learning_curve.py runs/NAME."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # a training machine has no display

import matplotlib.pyplot as plt

from maniskill_grpd.learning.run_log import read_rows

PANELS = (
    ("return", "return"),
    ("success_once", "success rate (once)"),
    ("mean_distance", "final mean distance [m]"),
)


def plot_learning_curve(run_dir: Path, path: Path | None = None) -> Path:
    """Plot return, success and distance over environment steps, in training and in evaluation.

    Args:
        run_dir: Folder of a run.
        path: The PNG to write; by default learning_curve.png in the folder.

    Returns:
        The file that was written.

    Raises:
        ValueError: If the run has logged nothing.
    """
    rows = read_rows(run_dir / "metrics.jsonl")
    if not rows:
        raise ValueError(f"{run_dir / 'metrics.jsonl'} holds no metrics")
    figure, axes = plt.subplots(
        1, len(PANELS), figsize=(4.2 * len(PANELS), 3.2), constrained_layout=True
    )
    for axis, (key, label) in zip(axes, PANELS, strict=True):
        for kind, style in (
            ("train", {"lw": 1.0, "alpha": 0.6}),
            ("eval", {"lw": 2.0, "marker": "o", "ms": 3}),
        ):
            steps, values = _series(rows, f"{kind}/{key}")
            axis.plot(steps, values, label=kind, **style)
        axis.set_xlabel("environment steps")
        axis.set_ylabel(label)
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.suptitle(run_dir.name, fontsize=9)
    path = path or run_dir / "learning_curve.png"
    figure.savefig(path, dpi=150)
    plt.close(figure)
    return path


def _series(rows: list[dict[str, Any]], tag: str) -> tuple[list[int], list[float]]:
    found = [(row["global_step"], row[tag]) for row in rows if tag in row]
    return [step for step, _ in found], [value for _, value in found]


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run_dir", type=Path, help="folder of a run")
    print(plot_learning_curve(parser.parse_args().run_dir))
