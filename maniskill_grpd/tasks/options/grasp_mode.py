"""Whether grippers hold on for a whole episode or open and close by the action."""

from __future__ import annotations

from maniskill_grpd.agents.floating_grippers import NUMBERS_PER_GRIPPER

CONTROL_MODES = {"fixed": "pd_ee_delta_pos", "free": "pd_ee_delta_pos_grip"}
"""The control mode that goes with each value of the option `grasp`."""


def choose_grasp(grasp: str | None, control_mode: str | None) -> tuple[str, str]:
    """Bring the options `grasp` and `control_mode` together: each follows from the other.

    Returns:
        "fixed" (default) or "free", and the control mode.

    Raises:
        ValueError: If one is unknown, or they contradict each other.
    """
    if grasp not in (None, *CONTROL_MODES):
        raise ValueError(f"grasp must be one of {list(CONTROL_MODES)}, got {grasp!r}")
    if control_mode not in (None, *NUMBERS_PER_GRIPPER):
        raise ValueError(f"control_mode must be one of {list(NUMBERS_PER_GRIPPER)}, got {control_mode!r}")
    if grasp is None:
        grasp = "free" if control_mode == CONTROL_MODES["free"] else "fixed"
    if control_mode not in (None, CONTROL_MODES[grasp]):
        raise ValueError(f"grasp={grasp!r} goes with control_mode={CONTROL_MODES[grasp]!r}, got {control_mode!r}")
    return grasp, CONTROL_MODES[grasp]
