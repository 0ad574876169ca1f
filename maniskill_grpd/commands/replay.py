"""Replay trajectories of these tasks with ManiSkill's tool, whose flags and output it has.

maniskill-grpd replay --traj-path demos/ClothFolding-v1/trajectory.h5 --use-env-states -o state --save-traj
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import report_errors
from maniskill_grpd.trajectory.replay import replay


def main(arguments: Sequence[str]) -> int:
    """Run the command."""

    def run() -> None:
        replay(arguments)

    return report_errors(run)
