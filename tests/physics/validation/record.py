"""What a validation case reports: a measured number beside its closed form, with a derived tolerance."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number of a simulation beside the number that theory gives."""

    test: str
    """Validation test, "T1" to "T14"."""
    what: str
    """Quantity and parameters, with its unit."""
    equation: str
    """The closed form."""
    expected: float
    measured: float
    tolerance: float
    """Largest |measured - expected| that step, resolution and float32 explain."""
    why: str
    """What the tolerance is made of."""

    @property
    def holds(self) -> bool:
        """True when measured and expected agree within the tolerance; NaN never holds."""
        return abs(self.measured - self.expected) <= self.tolerance


@dataclass(frozen=True, kw_only=True)
class Case:
    """One simulation with its parameters."""

    test: str
    run: Callable[..., Iterator[Check]]
    options: dict = field(default_factory=dict)
    slow: bool = False
    """Takes more than a few seconds."""

    def checks(self) -> list[Check]:
        """Simulate and compare."""
        return list(self.run(self.test, **self.options))

    def __str__(self) -> str:
        return "-".join([self.test, self.run.__name__, *(f"{key}={value}" for key, value in self.options.items())])
