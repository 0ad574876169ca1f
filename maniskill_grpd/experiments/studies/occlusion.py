"""What policies lose where cameras do not see every node, and what brings it back."""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.experiments.studies.parts import ALL_POLICIES, CLOTH_FOLDING, GRPD, ROPE_SHAPING
from maniskill_grpd.experiments.study import Arm, Condition, Options, Study, Task, combine, with_noise

TRAINED_FOV = 0.4
"""Vertical angle of the cameras in training [rad]: they miss a fifth of a rope and a third of a cloth that is folded."""
TESTED_FOVS = (0.95, 0.3)
"""Those of the other tests: the one that the tasks have, which misses what is covered alone, and a narrower one."""
SIGMA = 0.02
KEYPOINTS = 8
CAMERA: Options = {"visibility": "camera", "sensor_configs": {"fov": TRAINED_FOV}}
VIEWS: dict[str, Options] = {
    "mask": CAMERA,
    "stale": {**CAMERA, "hidden_nodes": "stale"},
    "keypoints": {**CAMERA, "keypoints": KEYPOINTS},
    "two cameras": {**CAMERA, "num_cameras": 2},
}
"""What policies that are trained under occlusion see."""


def _through(fov: float, **options: object) -> Condition:
    return Condition(env_options={"sensor_configs": {"fov": fov}, **options}, factors={"fov": fov})


def _with_noise_too(seen: Sequence[Condition]) -> list[Condition]:
    return [*seen, with_noise(SIGMA), *(combine(condition, with_noise(SIGMA)) for condition in seen)]


def _views(task: Task) -> list[Task]:
    """Return a task as it is seen whole, also tested behind cameras, and as policies see it that are trained behind them."""
    behind = [_through(fov, visibility="camera") for fov in (TRAINED_FOV, *TESTED_FOVS)]
    others = _with_noise_too([_through(fov) for fov in TESTED_FOVS])
    trained = [task.trained_with(_label(task, view), **options).tested(others) for view, options in VIEWS.items()]
    return [task.tested(_with_noise_too(behind)), *trained]


def _label(task: Task, view: str) -> str:
    return f"{task.env_id}, {view}"


OCCLUSION = Study(
    name="occlusion",
    title="Occlusion",
    question="What does a policy lose that sees only the nodes its cameras see, with noise on them and with cameras that see "
    "more or fewer (fov [rad])? Hidden nodes are masked, stay where they were last seen, or only keypoints are detected; one "
    "camera or two. Policies that were trained on all nodes are tested behind the same cameras.",
    tasks=(*_views(ROPE_SHAPING), *_views(CLOTH_FOLDING)),
    arms=ALL_POLICIES,
    metrics=("success_at_end", "return", "hidden_share"),
    plots=("bars", "curves"),
)

_FULL_CRITIC = Arm(
    name="full_critic",
    train_options={"critic_observations": "full"},
    partner="grpd",
    difference="the value function sees all nodes in training",
)

CRITIC = Study(
    name="critic",
    title="A critic that sees all nodes",
    question="Does a policy that sees a part of the nodes learn better if its value function sees all of them in training? GRPD.",
    tasks=tuple(
        task.trained_with(_label(task, view), **VIEWS[view])
        for task in (ROPE_SHAPING, CLOTH_FOLDING)
        for view in ("mask", "keypoints")
    ),
    arms=(GRPD, _FULL_CRITIC),
    metrics=("success_at_end", "return", "training_return"),
    plots=("bars", "curves"),
)
