"""Whether grippers hold on for a whole episode or open and close by the action."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

FREE_SUFFIX = "_grip"
"""What is behind the name of a control mode whose action opens and closes grippers."""


def choose_grasp(grasp: str | None, control_mode: str | None, modes: Iterable[str]) -> tuple[str, str]:
    """Bring the options `grasp` and `control_mode` together: each follows from the other.

    Args:
        grasp: "fixed", "free" or None.
        control_mode: One of `modes`, perhaps with "_grip" behind it, or None.
        modes: Names of the control modes of the agents, the default first.

    Returns:
        "fixed" (default) or "free", and the control mode.

    Raises:
        ValueError: If one is unknown, or they contradict each other.
    """
    modes = list(modes)
    if grasp not in (None, "fixed", "free"):
        raise ValueError(f"grasp must be one of {['fixed', 'free']}, got {grasp!r}")
    allowed = modes + [mode + FREE_SUFFIX for mode in modes]
    if control_mode not in (None, *allowed):
        raise ValueError(f"control_mode must be one of {allowed}, got {control_mode!r}")
    is_free = grasp == "free" if control_mode is None else control_mode.endswith(FREE_SUFFIX)
    mode = (control_mode or modes[0]).removesuffix(FREE_SUFFIX)
    wanted = mode + FREE_SUFFIX if grasp == "free" else mode
    if control_mode is not None and grasp is not None and control_mode != wanted:
        raise ValueError(f"grasp={grasp!r} goes with control_mode={wanted!r}, got {control_mode!r}")
    return ("free", mode + FREE_SUFFIX) if is_free else ("fixed", mode)


def with_release(settings: dict[str, Any]) -> dict[str, Any]:
    """Let grippers open by default, and refuse settings under which they cannot."""
    if settings.get("grasp") == "fixed" or settings.get("control_mode") == "pd_ee_delta_pos":
        raise ValueError("release=True needs grippers that open: grasp='free', control_mode='pd_ee_delta_pos_grip'")
    return {**settings, "grasp": "free"}
