"""What policies lose where cameras do not see every node, and what brings it back."""

from __future__ import annotations

from maniskill_grpd.experiments.studies.parts import ALL_POLICIES, CLOTH_FOLDING, GRPD, ROPE_SHAPING
from maniskill_grpd.experiments.study import Arm, Condition, Options, Study, Task, combine, with_noise

FIELDS_OF_VIEW = (0.7, 0.5)
"""Vertical angles of all cameras [rad], 0.95 in training: what they leave out is hidden, more of it the narrower they are."""
SIGMA = 0.02
KEYPOINTS = 8
VIEWS: dict[str, Options] = {
    "mask": {"visibility": "camera"},
    "stale": {"visibility": "camera", "hidden_nodes": "stale"},
    "keypoints": {"visibility": "camera", "keypoints": KEYPOINTS},
    "two cameras": {"visibility": "camera", "num_cameras": 2},
}
"""What policies that are trained under occlusion see."""


def _narrower(fov: float, **options: object) -> Condition:
    return Condition(env_options={"sensor_configs": {"fov": fov}, **options}, factors={"fov": fov})


def _grid(*seen: Condition) -> list[Condition]:
    """Return conditions of sight and those with noise too."""
    return [*seen, with_noise(SIGMA), *(combine(condition, with_noise(SIGMA)) for condition in seen)]


def _views(task: Task) -> list[Task]:
    """Return a task as it is seen whole, also tested behind cameras, and as policies see it that are trained behind them."""
    behind = Condition(env_options={"visibility": "camera"}, factors={"view": "mask"})
    unseen = [behind, *(combine(behind, _narrower(fov)) for fov in FIELDS_OF_VIEW)]
    narrower = [_narrower(fov) for fov in FIELDS_OF_VIEW]
    return [
        task.tested(_grid(*unseen)),
        *(task.trained_with(_label(task, view), **options).tested(_grid(*narrower)) for view, options in VIEWS.items()),
    ]


def _label(task: Task, view: str) -> str:
    return f"{task.env_id}, {view}"


OCCLUSION = Study(
    name="occlusion",
    title="Occlusion",
    question="What does a policy lose that sees only the nodes its cameras see, with noise on them and with narrower cameras, "
    "which see fewer? Hidden nodes are masked, stay where they were last seen, or only keypoints are detected; one camera or "
    "two. Policies that were trained on all nodes are tested behind the same cameras.",
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
