"""What carries over: policies tested under other conditions than those they were trained on."""

from __future__ import annotations

from maniskill_grpd.experiments.studies.parts import (
    ALL_NODES_SEEN,
    ALL_POLICIES,
    BASELINES,
    CLOTH_FOLDING,
    CLOTH_HANGING,
    ROPE_SHAPING,
    ROPE_WRAPPING,
    at_resolution,
    is_better,
    retains,
)
from maniskill_grpd.experiments.study import AS_TRAINED, Condition, Study, Task, combine, with_noise, with_option

SIGMAS = (0.0, 0.01, 0.02, 0.05, 0.1)


def _under_noise(task: Task, *resolutions: int) -> Task:
    """Test under noise, at the resolution of the training and at finer ones."""
    objects = (AS_TRAINED, *(at_resolution(num) for num in resolutions))
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
        *(retains(f"Keeps its return at sigma = {sigma}", "III.E", ROPE_SHAPING, (f"sigma={sigma}",)) for sigma in SIGMAS[1:]),
        *(
            is_better(f"More return than {arm.name} at sigma = 0.05", "III.E", arm, ROPE_SHAPING, conditions=("sigma=0.05",))
            for arm in BASELINES
        ),
        *(
            is_better(
                f"More return than {arm.name} at sigma = 0.05 and 1,225 nodes",
                "III.E, Fig. 5",
                arm,
                CLOTH_FOLDING,
                conditions=("resolution=1225, sigma=0.05",),
            )
            for arm in BASELINES
        ),
    ),
)


def _finer(resolutions: tuple[int, ...]) -> tuple[Condition, ...]:
    return (ALL_NODES_SEEN, *(at_resolution(num) for num in resolutions))


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
        retains("Adapts to finer ropes", "III.E", ROPE_SHAPING, ("resolution=200",)),
        retains("Adapts to cloth of over 1,000 nodes", "III.E, B.D", CLOTH_FOLDING, ("resolution=1225",)),
        retains("Adapts to cloth of over 1,000 nodes", "III.E, B.D", CLOTH_HANGING, ("resolution=1225",)),
    ),
)

_ROPE_SHAPES = ROPE_SHAPING.trained_with("RopeShaping-v1, three shapes", shapes=["W", "U", "S"])
_FOLDED = CLOTH_FOLDING.trained_with("ClothFolding-v1, squares and rectangles", shapes=["square", "rectangle"])
_UNSEEN_OUTLINES = tuple(with_option("shapes", name) for name in ("triangle", "hexagon", "circle", "l_shape"))
_HALF_HOLE = 0.05
"""Half of the side of a hole in a cloth that is folded [m]; the cloth is about 0.4 m wide."""
_SQUARE_HOLE = [[-_HALF_HOLE, -_HALF_HOLE], [_HALF_HOLE, -_HALF_HOLE], [_HALF_HOLE, _HALF_HOLE], [-_HALF_HOLE, _HALF_HOLE]]
_WITH_HOLE = tuple(
    Condition(env_options={"shapes": name, "holes": [_SQUARE_HOLE]}, factors={"shapes": name, "hole": "10 cm"})
    for name in ("square", "hexagon")
)
_UNSEEN_HOLES = tuple(with_option("hole_radius", radius) for radius in (0.05, 0.08))
_UNSEEN_POSTS = tuple(with_option("shapes", name) for name in ("box", "prism"))
_OUTLINE_NAMES = tuple(condition.name for condition in _UNSEEN_OUTLINES)

UNSEEN_SHAPES = Study(
    name="unseen_shapes",
    title="Unseen shapes",
    question="Does a policy work on shapes it was not trained on: goals of ropes, all of which can be reached (a search lays "
    "each of them, docs/benchmarks/goal_shapes.json), outlines of cloth and holes in it, posts? Cloths to be folded are squares "
    "and rectangles in training, without holes.",
    tasks=(
        _FOLDED.tested((*_UNSEEN_OUTLINES, *_WITH_HOLE)),
        _ROPE_SHAPES.tested(with_option("shapes", name) for name in ("V", "L", "O", "spiral")),
        CLOTH_HANGING.tested((*_UNSEEN_OUTLINES[1:], *_UNSEEN_HOLES)),
        ROPE_WRAPPING.tested(_UNSEEN_POSTS),
    ),
    arms=ALL_POLICIES,
    claims=(
        retains("Keeps its return on triangle, hexagon, circle and L", "III.F", _FOLDED, _OUTLINE_NAMES, paper="over 85 %"),
        *(
            retains(
                f"{arm.name} falls on triangle, hexagon, circle and L",
                "III.F",
                _FOLDED,
                _OUTLINE_NAMES,
                arm,
                "below 60 %",
                at_least=float("-inf"),
                at_most=0.6,
            )
            for arm in BASELINES
        ),
        retains("Keeps its return on cloth with a hole", "B.D", _FOLDED, tuple(c.name for c in _WITH_HOLE)),
        retains("Keeps its return with other holes", "B.D", CLOTH_HANGING, tuple(c.name for c in _UNSEEN_HOLES)),
        retains("Lays V, L and O", "B.B.a", _ROPE_SHAPES, ("shapes=V", "shapes=L", "shapes=O")),
        retains("Lays a spiral", "B.B.a", _ROPE_SHAPES, ("shapes=spiral",)),
    ),
)

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
        retains("Works with three grippers in place of four", "B.D", ROPE_SHAPING, ("num_grippers=3",)),
        retains("Works with one gripper in place of two", "B.D", CLOTH_FOLDING, ("num_grippers=1",)),
        retains("Works with three grippers in place of four", "B.D", CLOTH_HANGING, ("num_grippers=3",)),
    ),
)
