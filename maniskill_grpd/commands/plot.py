"""Draw the learning curves of one or several runs, also of runs that are still going.

maniskill-grpd plot runs/NAME [runs/OTHER ...] --metrics return success_at_end --output curves.png
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.runs.learning_curve import plot_learning_curves


@dataclass(frozen=True, kw_only=True)
class PlotConfig:
    """Options of the plot."""

    run_dirs: tyro.conf.Positional[tuple[Path, ...]]
    """folders of runs, one colour each"""
    metrics: tuple[str, ...] = ()
    """metrics of episodes, one panel each; by default return, success and the progress of the task"""
    output: Path | None = None
    """PNG to write; by default learning_curve.png in the first folder"""

    def __post_init__(self) -> None:
        if not self.run_dirs:
            raise ValueError("give at least one folder of a run")


def plot(config: PlotConfig) -> None:
    """Draw, and say where."""
    path = config.output or config.run_dirs[0] / "learning_curve.png"
    print(plot_learning_curves(config.run_dirs, path, config.metrics or None))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(plot, PlotConfig, arguments)
