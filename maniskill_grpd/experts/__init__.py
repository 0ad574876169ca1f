"""Scripted experts: proof that tasks are solvable, sources of demonstrations, reference lines."""

from __future__ import annotations

from typing import Any

from maniskill_grpd.experts.cloth_folding_expert import ClothFoldingExpert
from maniskill_grpd.experts.cloth_hanging_expert import ClothHangingExpert
from maniskill_grpd.experts.expert import Expert
from maniskill_grpd.experts.rope_shaping_expert import RopeShapingExpert
from maniskill_grpd.experts.rope_wrapping_expert import RopeWrappingExpert

EXPERTS: dict[str, type[Expert]] = {
    "ClothFolding-v1": ClothFoldingExpert,
    "ClothHanging-v1": ClothHangingExpert,
    "RopeShaping-v1": RopeShapingExpert,
    "RopeWrapping-v1": RopeWrappingExpert,
}
"""Expert classes by the id of their task."""


def register_expert(env_id: str, expert: type[Expert]) -> None:
    """Make an expert of one's own known to `make_expert`, and so to demonstrations, cloning, gallery and benchmarks.

    Args:
        env_id: Id of a task.
        expert: Its class; `expert.task` is the class of the environments.

    Raises:
        TypeError: If it is no `Expert`, or does not say in which task it acts.
        ValueError: If the task has an expert already.
    """
    if not (isinstance(expert, type) and issubclass(expert, Expert)):
        raise TypeError(f"an expert must be a subclass of Expert, got {expert!r}")
    if not hasattr(expert, "task"):
        raise TypeError(f"{expert.__name__}.task must be the class of the environments that it acts in")
    if EXPERTS.get(env_id, expert) is not expert:
        raise ValueError(f"{env_id!r} has an expert already, {EXPERTS[env_id].__name__}")
    EXPERTS[env_id] = expert


def make_expert(env_id: str, env: Any) -> Expert:
    """Make the expert of a task.

    Args:
        env_id: Id of the task, also of the form module:id.
        env: The environment it acts in, plain or wrapped, of any number of worlds.

    Returns:
        The expert; `expert.act()` gives the action for the present state of all worlds.

    Raises:
        ValueError: If the task has no expert, or `env` is an environment of another task.
    """
    expert = EXPERTS.get(env_id.rpartition(":")[2])
    if expert is None:
        raise ValueError(f"{env_id!r} has no expert; tasks with one are {sorted(EXPERTS)}")
    if not isinstance(env.unwrapped, expert.task):
        raise ValueError(f"the expert of {env_id!r} acts in a {expert.task.__name__}, got a {type(env.unwrapped).__name__}")
    return expert(env)


__all__ = [
    "EXPERTS",
    "ClothFoldingExpert",
    "ClothHangingExpert",
    "Expert",
    "RopeShapingExpert",
    "RopeWrappingExpert",
    "make_expert",
    "register_expert",
]
