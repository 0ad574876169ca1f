"""The option `resolution` of all tasks."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real


def check_resolutions(resolution: int | Sequence[int], low: int, high: int) -> tuple[int, ...]:
    """Return the resolutions that an option names, one number of nodes or several.

    Raises:
        ValueError: If there is none, or one is not a whole number in [low, high].
    """
    given = (resolution,) if isinstance(resolution, Real) else tuple(resolution)
    for value in given:
        if isinstance(value, bool) or int(value) != value or not low <= value <= high:
            raise ValueError(f"resolution must be in [{low}, {high}] nodes, got {value}")
    if not given:
        raise ValueError(f"resolution must name at least one number of nodes in [{low}, {high}], got none")
    return tuple(int(value) for value in given)
