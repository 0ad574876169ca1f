"""The studies, one for each claim of the paper.

Task options are small enough for two CPU cores: policies see a part of the nodes, the simulation has them all. Trainings that two
studies share, such as GRPD under BPP, are run once.
"""

from __future__ import annotations

from maniskill_grpd.experiments.claim import Claim, Side
from maniskill_grpd.experiments.study import AS_TRAINED, Arm, Condition, Study, Task, combine, with_noise, with_option

ROPE_SHAPING = Task(env_id="RopeShaping-v1", options={"resolution": 41, "graph_nodes": 21})
ROPE_WRAPPING = Task(env_id="RopeWrapping-v1", options={"resolution": 41, "graph_nodes": 21})
CLOTH_FOLDING = Task(
    env_id="ClothFolding-v1", options={"resolution": 64, "graph_nodes": 25, "shapes": ["square", "triangle", "rectangle"]}
)
CLOTH_HANGING = Task(env_id="ClothHanging-v1", options={"resolution": 64, "graph_nodes": 25})
ALL_TASKS = (ROPE_SHAPING, ROPE_WRAPPING, CLOTH_FOLDING, CLOTH_HANGING)

GRPD = Arm(name="grpd")
EMPN = Arm(name="empn", policy="empn")
HETERO_GNN = Arm(name="hetero_gnn", policy="hetero_gnn")
TRANSFORMER = Arm(name="transformer", policy="transformer")
BASELINES = (EMPN, HETERO_GNN, TRANSFORMER)
ALL_POLICIES = (GRPD, *BASELINES)


def _at_resolution(num_nodes: int) -> Condition:
    """The policy sees every node of a finer object."""
    return with_option("resolution", num_nodes, graph_nodes=None)


_ALL_NODES_SEEN = with_option("graph_nodes", None)
"""The object of the training, of which the policy sees every node: what changes by seeing more, not by simulating more."""


def _is_better(
    text: str,
    source: str,
    than: Arm,
    task: Task | None = None,
    metric: str = "return",
    paper: str = "-",
    conditions: tuple[str, ...] = (),
    measure: str = "gain",
) -> Claim:
    """GRPD scores more than another arm."""
    name = None if task is None else task.name
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure=measure,
        metric=metric,
        at_least=0.0,
        ours=Side(GRPD.name, name, conditions),
        theirs=Side(than.name, name, conditions),
    )


def _retains(
    text: str,
    source: str,
    task: Task,
    conditions: tuple[str, ...],
    arm: Arm = GRPD,
    paper: str = "-",
    at_least: float = 0.85,
    at_most: float = float("inf"),
) -> Claim:
    """An arm keeps a share of its return under other conditions; 85 % where the paper gives no figure."""
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure="ratio",
        metric="return",
        at_least=at_least,
        at_most=at_most,
        ours=Side(arm.name, task.name, conditions),
        theirs=Side(arm.name, task.name),
    )


# ---------------------------------------------------------------------------------------------------------------------- main

MAIN = Study(
    name="main",
    title="Main results",
    question="Does GRPD reach higher returns, earlier, than the three baselines? Equal budgets, sizes and hyper-parameters.",
    tasks=ALL_TASKS,
    arms=ALL_POLICIES,
    metrics=("success_at_end", "return", "training_return"),
    plots=("bars", "curves", "profile"),
    claims=(
        _is_better("Higher return than the equivariant MPN", "III.C", EMPN, CLOTH_HANGING, paper="+18 %"),
        _is_better("Higher return than the Transformer", "III.C", TRANSFORMER, CLOTH_HANGING, paper="+32 %"),
        *(_is_better(f"Higher return than {arm.name}", "III.C", arm) for arm in BASELINES),
        *(
            _is_better(f"Faster learning than {arm.name} (return over training)", "III.C", arm, ROPE_SHAPING, "training_return")
            for arm in BASELINES
        ),
    ),
)

# -------------------------------------------------------------------------------------------------------------- equivariance

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
        _is_better(
            "Higher test success with equivariance",
            "III.D.a",
            HETERO_GNN,
            CLOTH_FOLDING,
            "success_at_end",
            "78 %, without 59 %",
            measure="difference",
        ),
        _is_better("Without equivariance performance degrades", "B.B.b", HETERO_GNN, CLOTH_HANGING, paper="over 20 %"),
        _is_better(
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

# ------------------------------------------------------------------------------------------------------------- heterogeneity

HETEROGENEITY = Study(
    name="heterogeneity",
    title="Heterogeneity",
    question="What is lost with one type of nodes and edges? empn is equivariant and homogeneous.",
    tasks=ALL_TASKS,
    arms=(GRPD, EMPN),
    claims=tuple(
        _is_better("Higher return with types of nodes", "III.D.b", EMPN, task, paper="+10 to 15 %") for task in ALL_TASKS
    ),
)

# ---------------------------------------------------------------------------------------------------------------- bpp_vs_ppo

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

# --------------------------------------------------------------------------------------------------------------------- noise

SIGMAS = (0.0, 0.01, 0.02, 0.05, 0.1)


def _under_noise(task: Task, *resolutions: int) -> Task:
    """Test under noise, at the resolution of the training and at finer ones."""
    objects = (AS_TRAINED, *(_at_resolution(num) for num in resolutions))
    grid = [combine(obj, with_noise(sigma)) for obj in objects for sigma in SIGMAS]
    return task.tested(condition for condition in grid if condition.factors)


NOISE = Study(
    name="noise",
    title="Noise on observations",
    question="How much Gaussian noise on all observed positions [m] and velocities [m/s] does a policy tolerate that was trained "
    "without noise, and does it tolerate less on finer objects? Fig. 5.",
    tasks=(_under_noise(ROPE_SHAPING, 81, 161), _under_noise(CLOTH_FOLDING, 400, 1225)),
    arms=ALL_POLICIES,
    trained_by="main",
    plots=("lines", "heat_map"),
    factor="sigma",
    claims=(
        *(_retains(f"Keeps its return at sigma = {sigma}", "III.E", ROPE_SHAPING, (f"sigma={sigma}",)) for sigma in SIGMAS[1:]),
        *(
            _is_better(f"More return than {arm.name} at sigma = 0.05", "III.E", arm, ROPE_SHAPING, conditions=("sigma=0.05",))
            for arm in BASELINES
        ),
    ),
)

# ---------------------------------------------------------------------------------------------------------------- resolution


def _finer(resolutions: tuple[int, ...]) -> tuple[Condition, ...]:
    return (_ALL_NODES_SEEN, *(_at_resolution(num) for num in resolutions))


RESOLUTION = Study(
    name="resolution",
    title="Finer objects than in training",
    question="Does a policy trained on coarse objects, and seeing part of their nodes, work on finer ones, seeing all of them?",
    tasks=(
        ROPE_SHAPING.tested(_finer((81, 121, 200))),
        ROPE_WRAPPING.tested(_finer((81, 121, 200))),
        CLOTH_FOLDING.tested(_finer((225, 625, 1225))),
        CLOTH_HANGING.tested(_finer((225, 625, 1225))),
    ),
    arms=ALL_POLICIES,
    trained_by="main",
    plots=("lines",),
    factor="resolution",
    claims=(
        _retains("Adapts to finer ropes", "III.E", ROPE_SHAPING, ("resolution=200",)),
        _retains("Adapts to cloth of over 1,000 nodes", "III.E, B.D", CLOTH_FOLDING, ("resolution=1225",)),
        _retains("Adapts to cloth of over 1,000 nodes", "III.E, B.D", CLOTH_HANGING, ("resolution=1225",)),
    ),
)

# ------------------------------------------------------------------------------------------------------------- unseen_shapes

_ROPE_SHAPES = ROPE_SHAPING.trained_with("RopeShaping-v1, three shapes", shapes=["W", "U", "S"])
_UNSEEN_CLOTH = tuple(with_option("shapes", name) for name in ("hexagon", "circle", "l_shape"))
_UNSEEN_HOLES = tuple(with_option("hole_radius", radius) for radius in (0.05, 0.08))
_UNSEEN_POSTS = tuple(with_option("shapes", name) for name in ("box", "prism"))
_UNSEEN_NAMES = tuple(condition.name for condition in _UNSEEN_CLOTH)

UNSEEN_SHAPES = Study(
    name="unseen_shapes",
    title="Unseen shapes",
    question="Does a policy work on shapes it was not trained on: goals of ropes, outlines of cloth and holes in it, posts?",
    tasks=(
        CLOTH_FOLDING.tested(_UNSEEN_CLOTH),
        _ROPE_SHAPES.tested(with_option("shapes", name) for name in ("V", "L", "O", "spiral")),
        CLOTH_HANGING.tested((*_UNSEEN_CLOTH, *_UNSEEN_HOLES)),
        ROPE_WRAPPING.tested(_UNSEEN_POSTS),
    ),
    arms=ALL_POLICIES,
    claims=(
        _retains("Keeps its return on hexagon, circle and L", "III.F", CLOTH_FOLDING, _UNSEEN_NAMES, paper="over 85 %"),
        *(
            _retains(
                f"{arm.name} falls on hexagon, circle and L",
                "III.F",
                CLOTH_FOLDING,
                _UNSEEN_NAMES,
                arm,
                "below 60 %",
                at_least=0.0,
                at_most=0.6,
            )
            for arm in BASELINES
        ),
        _retains("Keeps its return with other holes", "B.D", CLOTH_HANGING, tuple(c.name for c in _UNSEEN_HOLES)),
        _retains("Lays a spiral", "B.B.a", _ROPE_SHAPES, ("shapes=spiral",)),
    ),
)

# ------------------------------------------------------------------------------------------------------------------ grippers

GRIPPERS = Study(
    name="grippers",
    title="Other grippers than in training",
    question="Does a policy work with fewer grippers, which hold other places?",
    tasks=(
        ROPE_SHAPING.tested(with_option("num_grippers", num) for num in (3, 2)),
        CLOTH_FOLDING.tested([with_option("num_grippers", 1)]),
        CLOTH_HANGING.tested([with_option("num_grippers", 3)]),
    ),
    arms=ALL_POLICIES,
    trained_by="main",
    claims=(
        _retains("Works with three grippers in place of four", "B.D", ROPE_SHAPING, ("num_grippers=3",)),
        _retains("Works with one gripper in place of two", "B.D", CLOTH_FOLDING, ("num_grippers=1",)),
        _retains("Works with three grippers in place of four", "B.D", CLOTH_HANGING, ("num_grippers=3",)),
    ),
)

# ---------------------------------------------------------------------------------------------------------------- pose_range

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
        *(_is_better(f"Higher return than {arm.name} in the full space", "Fig. 4", arm, _RANGES["full"]) for arm in BASELINES),
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

# ---------------------------------------------------------------------------------------------------------------------- cost

_SIZES = {
    num: Task(env_id=env_id, options={"resolution": num, "graph_nodes": None}, conditions=(), label=f"{env_id}, {num:,} nodes")
    for env_id, nums in (("RopeShaping-v1", (25, 50, 100, 200)), ("ClothHanging-v1", (400, 1225)))
    for num in nums
}


def _takes(text: str, source: str, paper: str, ours: Side, theirs: Side, at_most: float) -> Claim:
    return Claim(
        text=text,
        source=source,
        paper=paper,
        measure="ratio",
        metric="iteration_seconds",
        ours=ours,
        theirs=theirs,
        at_most=at_most,
    )


COST = Study(
    name="cost",
    title="Cost of training",
    question="How long does an iteration take, rollout and update, and how does that grow with the number of nodes? Small "
    "rollouts and one epoch; all nodes are seen.",
    tasks=tuple(_SIZES.values()),
    arms=ALL_POLICIES,
    metrics=("iteration_seconds", "update_seconds"),
    plots=("lines",),
    factor="resolution",
    budget=1200,
    train_options={"num_envs": 8, "num_steps": 50, "num_minibatches": 8, "update_epochs": 1, "eval_freq": 0},
    claims=(
        _takes(
            "At most 1.2 times the time of EMPN",
            "III.G",
            "1.2x",
            Side("grpd", _SIZES[200].name),
            Side("empn", _SIZES[200].name),
            1.2,
        ),
        _takes(
            "Faster than the Transformer at 1,225 nodes",
            "III.G",
            "significantly",
            Side("grpd", _SIZES[1225].name),
            Side("transformer", _SIZES[1225].name),
            1.0,
        ),
        _takes(
            "Grows no faster than the nodes from 400 to 1,225",
            "III.G",
            "linear",
            Side("grpd", _SIZES[1225].name),
            Side("grpd", _SIZES[400].name),
            1225 / 400,
        ),
    ),
)

# -------------------------------------------------------------------------------------------------------------- trust_region

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

# ------------------------------------------------------------------------------------------------------------------- decoder

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
        _is_better("Direction and magnitude improve learning", "B.C", Arm(name="naive"), task)
        for task in (ROPE_SHAPING, ROPE_WRAPPING)
    ),
)

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
