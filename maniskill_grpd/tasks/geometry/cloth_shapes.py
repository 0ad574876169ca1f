"""Shapes of cloth that tasks offer by name, and their resolutions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from maniskill_grpd.physics import (
    circle_outline,
    hexagon_outline,
    l_shape_outline,
    rectangle_outline,
    square_outline,
    triangle_outline,
)

RESOLUTIONS = (49, 1225)
"""Smallest and largest number of nodes of a cloth."""

# Outlines of area 1 m^2.
_UNIT_OUTLINES: dict[str, Callable[[], np.ndarray]] = {
    "square": lambda: square_outline(1.0),
    "rectangle": lambda: rectangle_outline(np.sqrt(1.5), np.sqrt(2.0 / 3.0)),
    "triangle": lambda: triangle_outline(2.0 / 3.0**0.25),
    "hexagon": lambda: hexagon_outline(np.sqrt(2.0) / 27.0**0.25),
    "circle": lambda: circle_outline(1.0 / np.sqrt(np.pi)),
    "l_shape": lambda: l_shape_outline(2.0 / np.sqrt(3.0)),
}
CLOTH_SHAPES = tuple(_UNIT_OUTLINES)
"""Names of all shapes."""


def cloth_outline(name: str, area: float) -> np.ndarray:
    """Return the outline of a cloth by its name.

    All shapes of one area have the same mass. A rectangle is 3 : 2, the arms of an L are half as wide as long, a triangle and a
    hexagon are regular.

    Args:
        name: One of `CLOTH_SHAPES`.
        area: Area enclosed [m^2].

    Returns:
        Closed polygon about the origin, counter-clockwise, (P, 2) float64 [m].

    Raises:
        ValueError: If there is no shape of that name.
    """
    return np.sqrt(area) * _UNIT_OUTLINES[check_cloth_shapes(name)[0]]()


def check_cloth_shapes(shapes: str | Sequence[str]) -> tuple[str, ...]:
    """Return one or several names of shapes as a tuple.

    Raises:
        ValueError: If there is none, or one is not in `CLOTH_SHAPES`.
    """
    names = (shapes,) if isinstance(shapes, str) else tuple(shapes)
    if not names or any(name not in CLOTH_SHAPES for name in names):
        raise ValueError(f"shapes of cloth must be among {', '.join(CLOTH_SHAPES)}, got {list(names)}")
    return names
