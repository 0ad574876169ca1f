"""The studies, one for each claim of the paper."""

from __future__ import annotations

from maniskill_grpd.experiments.studies.cost import COST
from maniskill_grpd.experiments.studies.generalization import GRIPPERS, NOISE, RESOLUTION, UNSEEN_SHAPES
from maniskill_grpd.experiments.studies.learning import (
    BPP_VS_PPO,
    DECODER,
    EQUIVARIANCE,
    HETEROGENEITY,
    MAIN,
    POSE_RANGE,
    TRUST_REGION,
)
from maniskill_grpd.experiments.study import Study

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        MAIN,
        EQUIVARIANCE,
        HETEROGENEITY,
        BPP_VS_PPO,
        NOISE,
        RESOLUTION,
        UNSEEN_SHAPES,
        GRIPPERS,
        POSE_RANGE,
        COST,
        TRUST_REGION,
        DECODER,
    )
}
"""All studies by name, in the order in which a reader meets them."""


def find_study(name: str) -> Study:
    """Return a study by its name.

    Raises:
        ValueError: If there is none, listing those there are.
    """
    if name not in STUDIES:
        raise ValueError(f"unknown study {name!r}; there are {', '.join(STUDIES)}")
    return STUDIES[name]
