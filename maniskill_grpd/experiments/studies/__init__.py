"""The studies, one for each claim of the paper."""

from __future__ import annotations

import dataclasses

from maniskill_grpd.experiments.studies.ablations import (
    ARCHITECTURE,
    DECODER,
    EQUIVARIANCE,
    FEATURES,
    HETEROGENEITY,
    UNSEEN_POSES,
)
from maniskill_grpd.experiments.studies.cost import COST
from maniskill_grpd.experiments.studies.generalization import GRIPPERS, NOISE, RESOLUTION, UNSEEN_SHAPES
from maniskill_grpd.experiments.studies.learning import BAR, MAIN, NEIGHBOUR, POSE_RANGE
from maniskill_grpd.experiments.studies.occlusion import CRITIC, OCCLUSION
from maniskill_grpd.experiments.studies.optimisation import BPP_VS_PPO
from maniskill_grpd.experiments.studies.parts import ALL_TASKS
from maniskill_grpd.experiments.studies.tuning import TUNING
from maniskill_grpd.experiments.study import Options, Study, Task

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        MAIN,
        EQUIVARIANCE,
        UNSEEN_POSES,
        HETEROGENEITY,
        BPP_VS_PPO,
        NOISE,
        RESOLUTION,
        UNSEEN_SHAPES,
        GRIPPERS,
        POSE_RANGE,
        BAR,
        OCCLUSION,
        CRITIC,
        COST,
        NEIGHBOUR,
        FEATURES,
        DECODER,
        ARCHITECTURE,
        *TUNING,
    )
}
"""All studies by name, in the order in which a reader meets them."""


def register_task(env_id: str, options: Options) -> None:
    """Let the studies that are about all tasks train on a further one; a task that a study has stays as it is there.

    Args:
        env_id: Its id, of the form module:id where a module has to be imported for it.
        options: Its options in training.
    """
    for study in STUDIES.values():
        if set(ALL_TASKS) <= set(study.tasks) and env_id not in {task.env_id for task in study.tasks}:
            STUDIES[study.name] = dataclasses.replace(study, tasks=(*study.tasks, Task(env_id=env_id, options=options)))


def find_study(name: str) -> Study:
    """Return a study by its name.

    Raises:
        ValueError: If there is none, listing those there are.
    """
    if name not in STUDIES:
        raise ValueError(f"unknown study {name!r}; there are {', '.join(STUDIES)}")
    return STUDIES[name]
