"""Test a checkpoint under every condition of a study.

maniskill-grpd evaluate_study --study noise --checkpoint runs/NAME/final_ckpt.pt

Each condition leaves a file in the folder of the tests, with the results of every episode; those that are there are not played
again. A condition that the task refuses leaves a file that says why, and the others go on.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.commands.study_tasks import register_tasks
from maniskill_grpd.experiments.condition_tests import ConditionTestConfig, run_tests


def evaluate_study(config: ConditionTestConfig) -> int:
    """Play the tests, and return whether a condition was refused; a line says which, and why."""
    register_tasks(config.own_tasks)
    errors = run_tests(config)
    for error in errors:
        print(f"error: {error}", file=sys.stderr)
    return int(bool(errors))


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(evaluate_study, ConditionTestConfig, arguments)
