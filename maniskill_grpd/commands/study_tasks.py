"""The tasks that studies learn of when they are run: those that are registered, beside those of the paper."""

from __future__ import annotations

from collections.abc import Iterable

import maniskill_grpd
from maniskill_grpd.experiments.studies import register_task
from maniskill_grpd.runs.environments import find_task, registered_tasks


def register_tasks(own_tasks: Iterable[str]) -> None:
    """Let the studies of all tasks train on every task of the package, and on tasks of one's own, of the form module:id.

    Raises:
        ValueError: If there is no such module or task.
    """
    for env_id, task in registered_tasks().items():
        if task.__module__.startswith(f"{maniskill_grpd.__name__}."):
            register_task(env_id, task.STUDY_OPTIONS)
    for env_id in own_tasks:
        register_task(env_id, find_task(env_id).STUDY_OPTIONS)
