"""Materials that differ from episode to episode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import torch

PROPERTIES = ("stretch", "bend", "mass", "friction", "damping")
"""What can be varied, see `Solver.set_material`."""


class MaterialRanges:
    """Factors on the material of an object, drawn anew for every episode.

    A factor is drawn so that its logarithm is uniform: a half is as likely as the double.

    Attributes:
        num_draws: Numbers that `factors` takes for each world.

    Args:
        ranges: By property, the smallest and the largest factor, or a number that is always taken.

    Raises:
        ValueError: If a property is unknown or a range is none; says what is allowed.
    """

    def __init__(self, ranges: Mapping[str, float | Sequence[float]] | None) -> None:
        self._logarithms = {name: _read(name, value) for name, value in (ranges or {}).items()}
        self.num_draws = len(self._logarithms)

    def factors(self, draws: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the factors (b,) of each property, from draws in [-1, 1) (b, num_draws)."""
        factors = {}
        for (name, (low, high)), draw in zip(self._logarithms.items(), draws.unbind(1), strict=True):
            factors[name] = torch.exp(low + (high - low) * 0.5 * (draw + 1.0))
        return factors


def _read(name: str, value: Any) -> tuple[float, float]:
    if name not in PROPERTIES:
        raise ValueError(f"material must name some of {list(PROPERTIES)}, got {name!r}")
    bounds = (value, value) if isinstance(value, (int, float)) else tuple(value)
    if len(bounds) != 2 or not all(math.isfinite(bound) and bound > 0.0 for bound in bounds) or bounds[0] > bounds[1]:
        raise ValueError(f"material[{name!r}] must be a factor > 0 or a pair (smallest, largest) of them, got {value!r}")
    return math.log(bounds[0]), math.log(bounds[1])
