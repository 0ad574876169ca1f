"""The option `substeps` of all tasks."""

from __future__ import annotations

MOST_SUBSTEPS = 1000
"""Substeps of a control step of 0.05 s, 50 microseconds each: below that single precision moves nodes by nothing but rounding."""


def check_substeps(substeps: int | None) -> int | None:
    """Return the number of substeps that an option names; None leaves it to each variant of the object.

    Raises:
        ValueError: If it is not a whole number in [1, 1000].
    """
    if substeps is None:
        return None
    if isinstance(substeps, bool) or int(substeps) != substeps or not 1 <= substeps <= MOST_SUBSTEPS:
        raise ValueError(f"substeps must be a whole number in [1, {MOST_SUBSTEPS}], got {substeps}")
    return int(substeps)
