"""Draw the learning curve of a run from its metrics.jsonl.

python baselines/plot_learning_curve.py runs/NAME [--metrics return success_at_end mean_distance]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")  # a training machine has no display

import matplotlib.pyplot as plt

from maniskill_grpd.learning.run_log import read_rows

LABELS = {
    "return": "return",
    "success_once": "success rate (once)",
    "success_at_end": "success rate (at the end)",
    "mean_distance": "final mean distance [m]",
}
"""Axis labels; other metrics are labelled by their names."""


def plot_learning_curve(
    run_dir: Path, path: Path | None = None, metrics: Sequence[str] | None = None
) -> Path:
    """Plot metrics of episodes over environment steps, in training and in evaluation.

    Args:
        run_dir: Folder of a run.
        path: The PNG to write; by default learning_curve.png in the folder.
        metrics: One panel each; by default return, success and, if there is one, the distance.

    Returns:
        The file that was written.

    Raises:
        ValueError: If the run has logged nothing, or not a metric that is asked for.
    """
    rows = read_rows(run_dir / "metrics.jsonl")
    if not rows:
        raise ValueError(f"{run_dir / 'metrics.jsonl'} holds no metrics")
    panels = _choose_panels(rows, metrics)
    figure, axes = plt.subplots(
        1, len(panels), figsize=(4.2 * len(panels), 3.2), constrained_layout=True, squeeze=False
    )
    axes = axes[0]
    for axis, key in zip(axes, panels, strict=True):
        for kind, style in (
            ("train", {"lw": 1.0, "alpha": 0.6}),
            ("eval", {"lw": 2.0, "marker": "o", "ms": 3}),
        ):
            steps, values = _series(rows, f"{kind}/{key}")
            axis.plot(steps, values, label=kind, **style)
        axis.set_xlabel("environment steps")
        axis.set_ylabel(LABELS.get(key, key))
        axis.grid(alpha=0.3)
    axes[0].legend()
    figure.suptitle(run_dir.name, fontsize=9)
    path = path or run_dir / "learning_curve.png"
    figure.savefig(path, dpi=150)
    plt.close(figure)
    return path


def _choose_panels(rows: list[dict[str, Any]], metrics: Sequence[str] | None) -> list[str]:
    tags = set().union(*rows)
    found = {tag.partition("/")[2] for tag in tags if tag.startswith(("train/", "eval/"))}
    if metrics is None:
        return [name for name in ("return", "success_once", "mean_distance") if name in found] or ["return"]
    unknown = [name for name in metrics if name not in found]
    if unknown:
        raise ValueError(f"the run has not logged {', '.join(unknown)}; it has {', '.join(sorted(found))}")
    return list(metrics)


def _series(rows: list[dict[str, Any]], tag: str) -> tuple[list[int], list[float]]:
    found = [(row["global_step"], row[tag]) for row in rows if tag in row]
    return [step for step, _ in found], [value for _, value in found]


def main(arguments: Sequence[str]) -> int:
    """Draw; report what the user can mend in one line instead of a traceback."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run_dir", type=Path, help="folder of a run")
    parser.add_argument("--metrics", nargs="+", help="metrics of episodes, one panel each")
    options = parser.parse_args(arguments)
    try:
        print(plot_learning_curve(options.run_dir, metrics=options.metrics))
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
