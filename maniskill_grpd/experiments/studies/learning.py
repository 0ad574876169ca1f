"""What is learned: the policies of the paper compared where they are trained."""

from __future__ import annotations

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.studies.parts import (
    ALL_POLICIES,
    ALL_TASKS,
    BASELINES,
    CLOTH_HANGING,
    EMPN,
    GRPD,
    HEPI,
    ROPE_SHAPING,
    TRANSFORMER,
    is_better,
)
from maniskill_grpd.experiments.study import Study

MAIN = Study(
    name="main",
    title="Main results",
    question="Does GRPD reach higher returns, earlier, than the three baselines? Equal budgets, sizes and hyper-parameters.",
    tasks=ALL_TASKS,
    arms=ALL_POLICIES,
    metrics=("success_at_end", "return", "training_return"),
    plots=("bars", "curves", "profile"),
    claims=(
        is_better("Higher return than the equivariant MPN", "III.C", EMPN, CLOTH_HANGING, paper="+18 %"),
        is_better("Higher return than the Transformer", "III.C", TRANSFORMER, CLOTH_HANGING, paper="+32 %"),
        *(is_better(f"Higher return than {arm.name}", "III.C", arm) for arm in BASELINES),
        *(
            is_better(f"Faster learning than {arm.name} (return over training)", "III.C", arm, ROPE_SHAPING, "training_return")
            for arm in BASELINES
        ),
    ),
)

RANGES = {
    "full": CLOTH_HANGING,
    **{share: CLOTH_HANGING.trained_with(f"ClothHanging-v1, {share}", pose_range=share) for share in ("half", "quarter")},
}
"""Cloth to be hung from all poses, and from those of a part of the ranges."""

POSE_RANGE = Study(
    name="pose_range",
    title="Spatial complexity",
    question="How do the policies compare when less of the pose space is sampled, in training and test? Fig. 4.",
    tasks=tuple(RANGES.values()),
    arms=ALL_POLICIES,
    plots=("lines", "curves"),
    factor="pose_range",
    claims=(
        *(is_better(f"Higher return than {arm.name} in the full space", "Fig. 4", arm, RANGES["full"]) for arm in BASELINES),
        *(
            Claim(
                text=f"{arm.name} improves as the space is reduced",
                source="Fig. 4",
                paper="-",
                measure="gain",
                metric="return",
                at_least=0.0,
                ours=Side(arm.name, RANGES["quarter"].name),
                theirs=Side(arm.name, RANGES["full"].name),
            )
            for arm in ALL_POLICIES
        ),
    ),
)

_OVER_BAR = CLOTH_HANGING.trained_with("ClothHanging-v1, bar", hanger="bar")
_LET_GO = CLOTH_HANGING.trained_with("ClothHanging-v1, bar, let go", hanger="bar", release=True)

BAR = Study(
    name="bar",
    title="Cloth over a bar",
    question="Is a cloth draped over a rigid bar (B.B.b), held to the end or let go?",
    tasks=(_OVER_BAR, _LET_GO),
    arms=ALL_POLICIES,
    metrics=("success_at_end", "return", "training_return"),
    plots=("bars", "curves"),
    claims=tuple(is_better(f"Higher return than {arm.name}", "B.B.b", arm, _OVER_BAR) for arm in BASELINES),
)

NEIGHBOUR = Study(
    name="hepi",
    title="A published neighbour",
    question="How does GRPD compare with HEPi (Hoang et al. 2025), heterogeneous and equivariant on a grid of directions, under "
    "the same trainer, inputs, decoder and number of parameters? The paper does not compare them.",
    tasks=(ROPE_SHAPING, CLOTH_HANGING),
    arms=(GRPD, HEPI),
    metrics=("success_at_end", "return", "training_return", "iteration_seconds"),
    plots=("bars", "curves"),
)
