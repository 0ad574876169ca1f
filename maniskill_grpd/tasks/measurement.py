"""What a task measures in its worlds."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Metric:
    """A number in `info` that tells something about a task.

    Attributes:
        name: Its key in `info`, where it is (B,) float.
        unit: SI unit, "" when dimensionless.
    """

    name: str
    unit: str
