"""What is learned: policies and algorithms compared where they are trained."""

from __future__ import annotations

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.studies.parts import (
    ALL_POLICIES,
    ALL_TASKS,
    BASELINES,
    CLOTH_FOLDING,
    CLOTH_HANGING,
    EMPN,
    GRPD,
    HETERO_GNN,
    ROPE_SHAPING,
    ROPE_WRAPPING,
    TRANSFORMER,
    is_better,
)
from maniskill_grpd.experiments.study import Arm, Study, with_option

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

_NARROW = ROPE_SHAPING.trained_with("RopeShaping-v1, quarter of the poses", pose_range="quarter")
_ALL_POSES = with_option("pose_range", "full")

EQUIVARIANCE = Study(
    name="equivariance",
    title="Equivariance",
    question="What is lost without SE(3) equivariance? hetero_gnn passes the same messages on raw coordinates. One task is "
    "trained on a quarter of the poses and tested on all of them.",
    tasks=(CLOTH_FOLDING, CLOTH_HANGING, _NARROW.tested([_ALL_POSES])),
    arms=(GRPD, HETERO_GNN),
    claims=(
        is_better(
            "Higher test success with equivariance",
            "III.D.a",
            HETERO_GNN,
            CLOTH_FOLDING,
            "success_at_end",
            "78 %, without 59 %",
            measure="difference",
        ),
        is_better("Without equivariance performance degrades", "B.B.b", HETERO_GNN, CLOTH_HANGING, paper="over 20 %"),
        is_better(
            "Generalises to poses outside those of the training",
            "B.B.b",
            HETERO_GNN,
            _NARROW,
            "success_at_end",
            conditions=(_ALL_POSES.name,),
            measure="difference",
        ),
    ),
)

HETEROGENEITY = Study(
    name="heterogeneity",
    title="Heterogeneity",
    question="What is lost with one type of nodes and edges? empn is equivariant and homogeneous.",
    tasks=ALL_TASKS,
    arms=(GRPD, EMPN),
    claims=tuple(
        is_better("Higher return with types of nodes", "III.D.b", EMPN, task, paper="+10 to 15 %") for task in ALL_TASKS
    ),
)

BPP = Arm(name="bpp")
PPO = Arm(name="ppo", algorithm="ppo")

BPP_VS_PPO = Study(
    name="bpp_vs_ppo",
    title="BPP against PPO",
    question="Does bounding the policy's change make learning better and steadier than clipping? GRPD, same rollouts.",
    tasks=(ROPE_WRAPPING, ROPE_SHAPING, CLOTH_HANGING),
    arms=(BPP, PPO),
    metrics=("success_at_end", "return", "training_return"),
    plots=("curves", "bars"),
    claims=(
        Claim(
            text="Smaller variance of returns over seeds",
            source="A.E.4",
            paper="-37 %",
            measure="spread",
            metric="return",
            ours=Side("bpp", CLOTH_HANGING.name),
            theirs=Side("ppo", CLOTH_HANGING.name),
            at_most=0.0,
        ),
        *(
            Claim(
                text="Higher return",
                source="III.D.c",
                paper="-",
                measure="gain",
                metric="return",
                at_least=0.0,
                ours=Side("bpp", task.name),
                theirs=Side("ppo", task.name),
            )
            for task in (ROPE_WRAPPING, ROPE_SHAPING)
        ),
    ),
)

_RANGES = {
    "full": CLOTH_HANGING,
    **{share: CLOTH_HANGING.trained_with(f"ClothHanging-v1, {share}", pose_range=share) for share in ("half", "quarter")},
}

POSE_RANGE = Study(
    name="pose_range",
    title="Spatial complexity",
    question="How do the policies compare when less of the pose space is sampled, in training and test? Fig. 4.",
    tasks=tuple(_RANGES.values()),
    arms=ALL_POLICIES,
    plots=("lines", "curves"),
    factor="pose_range",
    claims=(
        *(is_better(f"Higher return than {arm.name} in the full space", "Fig. 4", arm, _RANGES["full"]) for arm in BASELINES),
        Claim(
            text="Improves as the space is reduced",
            source="Fig. 4",
            paper="-",
            measure="gain",
            metric="return",
            at_least=0.0,
            ours=Side("grpd", _RANGES["quarter"].name),
            theirs=Side("grpd", _RANGES["full"].name),
        ),
    ),
)

TRUST_REGION = Study(
    name="trust_region",
    title="Ways to keep the trust region",
    question="Projection (eq. 10, 59-65), Lagrangian (66) or natural gradient (67, 68): which learns best? GRPD.",
    tasks=(ROPE_SHAPING, ROPE_WRAPPING),
    arms=(
        Arm(name="projection"),
        Arm(name="lagrangian", train_options={"trust_region": "lagrangian"}),
        Arm(name="fisher", train_options={"trust_region": "fisher"}),
    ),
    metrics=("success_at_end", "return", "training_return", "iteration_seconds"),
    plots=("curves", "bars"),
)

DECODER = Study(
    name="decoder",
    title="Decoders of actions",
    question="Direction times magnitude (eq. 51, 52) against one vector (eq. 50); one decoder for all grippers against one for "
    "each.",
    tasks=(ROPE_SHAPING, ROPE_WRAPPING),
    arms=(
        GRPD,
        Arm(name="naive", policy_options={"decoder": "naive"}),
        Arm(name="independent", policy_options={"decoders": "independent"}),
    ),
    plots=("curves", "bars"),
    claims=tuple(
        is_better("Direction and magnitude improve learning", "B.C", Arm(name="naive"), task)
        for task in (ROPE_SHAPING, ROPE_WRAPPING)
    ),
)
