"""Numbers that change while training goes on."""

from __future__ import annotations

import math

SCHEDULES = ("constant", "linear", "cosine")
"""Names of the ways from a first value to a last one."""


def scheduled(name: str, first: float, last: float, progress: float) -> float:
    """Return the value of a schedule.

    Args:
        name: "constant" stays at `first`; "linear" and "cosine" (half a period, flat at both ends)
            go to `last`.
        first: Value at progress 0.
        last: Value at progress 1.
        progress: Share of the iterations that are done, in [0, 1].

    Raises:
        ValueError: If there is no such schedule.
    """
    if name == "constant":
        return first
    if name == "linear":
        return first + (last - first) * progress
    if name == "cosine":
        return last + (first - last) * 0.5 * (1.0 + math.cos(math.pi * progress))
    raise ValueError(f"a schedule is one of {', '.join(SCHEDULES)}, got {name!r}")
