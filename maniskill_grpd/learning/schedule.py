"""Numbers that change while training goes on."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

Schedule = Literal["constant", "linear", "cosine"]
"""Names of the ways from a first value to a last one."""


@dataclass(frozen=True, kw_only=True)
class Coefficients:
    """What changes from iteration to iteration."""

    learning_rate: float
    ent_coef: float
    entropy_floor: float | None
    noise_correlation: float


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
    raise ValueError(f"a schedule is one of {', '.join(get_args(Schedule))}, got {name!r}")
