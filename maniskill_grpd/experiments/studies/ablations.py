"""What is lost without a part of GRPD: each arm differs from its partner in one thing."""

from __future__ import annotations

from maniskill_grpd.experiments.studies.learning import RANGES
from maniskill_grpd.experiments.studies.parts import (
    CLOTH_FOLDING,
    CLOTH_HANGING,
    EMPN,
    GRPD,
    GRPD_BLIND,
    GRPD_RAW,
    GRPD_SHARED,
    HETERO_GNN,
    ROPE_SHAPING,
    augmented,
    is_better,
)
from maniskill_grpd.experiments.study import Arm, Study, with_option

EQUIVARIANCE = Study(
    name="equivariance",
    title="Equivariance",
    question="What is lost without SE(3) equivariance, and what of it do turned batches bring back? grpd_raw is the same network "
    "whose first layers see raw coordinates; hetero_gnn passes messages by MLPs of them.",
    tasks=(CLOTH_FOLDING, CLOTH_HANGING),
    arms=(GRPD, GRPD_RAW, augmented(GRPD_RAW), HETERO_GNN, augmented(HETERO_GNN)),
    plots=("bars", "curves"),
    claims=(
        is_better(
            "Higher test success with equivariance",
            "III.D.a",
            GRPD_RAW,
            CLOTH_FOLDING,
            "success_at_end",
            "78 %, without 59 %",
            measure="difference",
        ),
        is_better("Without equivariance performance degrades", "B.B.b", GRPD_RAW, CLOTH_HANGING, paper="over 20 %"),
        *(
            is_better("Equivariance brings more than turned batches", "A.A", augmented(arm), task)
            for arm in (GRPD_RAW, HETERO_GNN)
            for task in (CLOTH_FOLDING, CLOTH_HANGING)
        ),
    ),
)

_ALL_POSES = with_option("pose_range", "full")
_NARROW = RANGES["quarter"].tested([_ALL_POSES])

UNSEEN_POSES = Study(
    name="unseen_poses",
    title="Unseen poses",
    question="Does a policy trained on a quarter of the poses hang a cloth from all of them?",
    tasks=(_NARROW,),
    arms=(GRPD, GRPD_RAW, augmented(GRPD_RAW), HETERO_GNN),
    claims=tuple(
        is_better(
            f"Generalises further than {arm.name}",
            "B.B.b",
            arm,
            _NARROW,
            "success_at_end",
            conditions=(_ALL_POSES.name,),
            measure="difference",
        )
        for arm in (GRPD_RAW, augmented(GRPD_RAW), HETERO_GNN)
    ),
)

HETEROGENEITY = Study(
    name="heterogeneity",
    title="Heterogeneity",
    question="What is lost with one type of nodes and edges? grpd_shared is the same network on the same edges with one set of "
    "weights (A.C.7); empn is homogeneous in its edges too. grpd_blind tells whether the task needs the object at all.",
    tasks=(CLOTH_FOLDING, CLOTH_HANGING),
    arms=(GRPD, GRPD_SHARED, GRPD_BLIND, EMPN),
    plots=("bars", "curves"),
    claims=tuple(
        is_better(text, "III.D.b", arm, task, paper=paper)
        for arm, text, paper in (
            (GRPD_SHARED, "Higher return with weights for each type", "+10 to 15 %"),
            (GRPD_BLIND, "Higher return with messages from the object", "-"),
        )
        for task in (CLOTH_FOLDING, CLOTH_HANGING)
    ),
)

_RICH = {task: task.trained_with(f"{task.env_id}, rich", graph_features="rich") for task in (ROPE_SHAPING, CLOTH_HANGING)}

FEATURES = Study(
    name="features",
    title="Features of grippers",
    question="The paper's graph (eq. 43), or summaries of the whole object on the grippers as well? With them a policy may do "
    "without the object, which grpd_blind shows.",
    tasks=tuple(variant for pair in _RICH.items() for variant in pair),
    arms=(GRPD, GRPD_BLIND),
    metrics=("success_at_end", "return", "training_return"),
    plots=("bars", "curves"),
)

_NAIVE = Arm(name="naive", policy_options={"decoder": "naive"}, partner="grpd", difference="one vector (eq. 50)")

DECODER = Study(
    name="decoder",
    title="Decoders of actions",
    question="Direction times magnitude (eq. 51, 52) against one vector (eq. 50); one decoder for all grippers against one for "
    "each. Do norms of actions grow, and smoothly (B.C)?",
    tasks=(ROPE_SHAPING, CLOTH_HANGING),
    arms=(
        GRPD,
        _NAIVE,
        Arm(
            name="independent",
            policy_options={"decoders": "independent"},
            partner="grpd",
            difference="a decoder for each gripper",
        ),
        Arm(
            name="unbounded",
            policy_options={"magnitude": "softplus"},
            partner="grpd",
            difference="magnitudes that nothing bounds",
        ),
    ),
    metrics=("success_at_end", "return", "training_return", "action_norm", "action_norm_growth"),
    plots=("curves", "bars", "action_norms"),
    claims=tuple(
        is_better("Direction and magnitude improve learning", "B.C", _NAIVE, task) for task in (ROPE_SHAPING, CLOTH_HANGING)
    ),
)


def _variant(difference: str, **options: object) -> Arm:
    ((key, value),) = options.items()
    return Arm(name=f"{key}={value}", policy_options=options, partner="grpd", difference=difference)


ARCHITECTURE = Study(
    name="architecture",
    title="Rounds, harmonics and gates",
    question="How many rounds of messages between objects, and which degrees of harmonics, does GRPD need? By default one round, "
    "degree 1, one radial function along mesh edges, and messages that depend on their receiver.",
    tasks=(ROPE_SHAPING, CLOTH_HANGING),
    arms=(
        GRPD,
        _variant("objects hear no neighbours", num_layers=0),
        _variant("two rounds between objects", num_layers=2),
        _variant("three rounds between objects", num_layers=3),
        _variant("degree 2 from objects to actuators", max_degree=2),
        _variant("degree 2 along mesh edges", max_local_degree=2),
        _variant("three radial functions along mesh edges", num_local_radial=3),
        _variant("messages that do not know their receiver", receiver_gates=False),
    ),
    metrics=("success_at_end", "return", "training_return", "iteration_seconds"),
    plots=("bars", "curves"),
)
