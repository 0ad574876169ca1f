"""Planar shapes that tasks take by name or as points."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np

Shape = str | tuple[tuple[float, float], ...]
"""A name, or points in the plane [m]: plain numbers, which compare, hash and become JSON."""
GivenShape = str | np.ndarray | Sequence[Sequence[float]]
"""What users may give for one."""


class ShapeRegistry(Mapping[str, np.ndarray]):
    """The points (P, 2) of shapes by their names, in the order in which they were registered.

    Args:
        kind: What they are, in the plural, for messages.
        wanted: What points have to be, for messages.
        check: Returns points as float64 (P, 2), or raises ValueError; called with what was given and what to call it.
    """

    def __init__(self, kind: str, wanted: str, check: Callable[[Any, str], np.ndarray]) -> None:
        self._kind, self._wanted, self._check = kind, wanted, check
        self._shapes: dict[str, np.ndarray] = {}

    def __getitem__(self, name: str) -> np.ndarray:
        return self._shapes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._shapes)

    def __len__(self) -> int:
        return len(self._shapes)

    def register(self, name: str, shape: GivenShape | Callable[[], GivenShape]) -> None:
        """Add a shape under a new name; a function is called once, for its points.

        Raises:
            ValueError: If the name is taken or no name, or the points are not what they have to be.
        """
        if not (isinstance(name, str) and name.strip()):
            raise ValueError(f"the name of a shape must be a text that is not empty, got {name!r}")
        if name in self._shapes:
            raise ValueError(f"there is already one of the {self._kind} with the name {name!r}; take another name")
        self._shapes[name] = self._check(shape() if callable(shape) else shape, f"the shape {name!r}")

    def points(self, shape: Shape) -> np.ndarray:
        """Return the points of a shape, (P, 2) float64 [m].

        Raises:
            ValueError: If there is no shape of that name, or the points are not what they have to be.
        """
        (shape,) = self.parse(shape if isinstance(shape, str) else [shape], "shapes")
        return self._shapes[shape] if isinstance(shape, str) else np.array(shape)

    def parse(self, given: GivenShape | Iterable[GivenShape], option: str) -> tuple[Shape, ...]:
        """Return what an option of a task gives, one shape or several, as a tuple.

        Args:
            given: A name, the points of one shape, or several of both.
            option: Name of the option, for messages.

        Raises:
            ValueError: If there is none, a name is not registered, or points are not what they have to be.
        """
        if not isinstance(given, Iterable) or isinstance(given, Mapping):
            raise self._refusal(given)
        entries = [given] if isinstance(given, str) or _is_table(given) else list(given)
        if not entries:
            raise self._refusal(entries)
        return tuple(self._parse_one(entry, f"{option}[{index}]", given) for index, entry in enumerate(entries))

    def _parse_one(self, entry: GivenShape, label: str, given: Any) -> Shape:
        if not isinstance(entry, str):
            return tuple((float(x), float(y)) for x, y in self._check(entry, label))
        if entry not in self._shapes:
            raise self._refusal(given)
        return entry

    def _refusal(self, given: Any) -> ValueError:
        names = ", ".join(self._shapes)
        return ValueError(f"{self._kind} must be among {names}, or {self._wanted}, got {given!r:.200}")


def shape_label(shape: Shape) -> str:
    """Return what to call a shape in messages."""
    return shape if isinstance(shape, str) else f"polygon of {len(shape)} points"


def _is_table(given: Any) -> bool:
    """Return whether something is a table of numbers, the points of one shape, and not several shapes."""
    if hasattr(given, "ndim"):
        return given.ndim == 2
    first = next(iter(given), None) if isinstance(given, Sequence) else None
    if isinstance(first, str) or not isinstance(first, (Sequence, np.ndarray)):
        return False
    return len(first) > 0 and isinstance(first[0], Real)
