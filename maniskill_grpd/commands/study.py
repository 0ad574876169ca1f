"""Run a study: one command for each claim of the paper.

maniskill-grpd study --study main --budget 1_000_000 --seeds 3
maniskill-grpd study --study main --quick            # a smoke test of every arm, in minutes
maniskill-grpd study --study main --dry_run          # what would be run, and about how long
maniskill-grpd study --study all --report --output docs/results

Runs lie in runs/ablate/, one folder each, and studies share them. A study that was stopped goes on with the same command: what
is finished is skipped, what was interrupted is resumed, what failed is tried again. A run that fails is marked, with its log, and
does not stop the others. At the end the study's rows are added to the CSV files of the results, and its page is written.
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.commands.study_tasks import register_tasks
from maniskill_grpd.experiments.present import present_mark
from maniskill_grpd.experiments.run_study import StudyConfig, run_study


def study(config: StudyConfig) -> int:
    """Run the study, and return whether a run failed."""
    register_tasks(config.own_tasks)
    return int(bool(run_study(config, present_mark)))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(study, StudyConfig, arguments)
