"""What a task measures in its worlds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch


@dataclass(frozen=True)
class Metric:
    """A number in `info` that tells something about a task.

    Attributes:
        name: Its key in `info`, where it is (B,) float.
        unit: SI unit, "" when dimensionless.
    """

    name: str
    unit: str

    @property
    def label(self) -> str:
        """Name and unit, as axes and tables show them."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    def format(self, value: float) -> str:
        """Return a value with its name and unit, in three digits."""
        return f"{self.name} {value:.3g} {self.unit}".rstrip()


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """How the episodes of B worlds stand; reward, observation and `info` all follow from it.

    A task adds what it measures beside these in a frozen subclass with fields of its own, such as the offsets of all nodes from
    their goals.
    """

    success: torch.Tensor
    """Whether the task is done at this step, (B,) bool."""
    fail: torch.Tensor | None = None
    """Whether the episode has failed, (B,) bool; None where nothing fails but worlds that have diverged, which always do."""
    metrics: Mapping[str, torch.Tensor] = field(default_factory=dict)
    """Numbers for `info`, each (B,)."""


@dataclass(frozen=True, kw_only=True)
class GoalMeasurement(Measurement):
    """A measurement where every node has a goal of its own."""

    goal_offsets: torch.Tensor
    """From the nodes to their goals, (B, N, 3) [m]."""
    goal_distances: torch.Tensor
    """Lengths of these, (B, N) [m]."""
