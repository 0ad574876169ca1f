"""What there is to see in one world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maniskill_grpd.rendering import palette


@dataclass(frozen=True)
class Tube:
    """A rope."""

    points: np.ndarray
    """Its axis, (n, 3) [m]."""
    radius: float
    """Half its thickness [m]."""


@dataclass(frozen=True)
class Sheet:
    """A cloth."""

    vertices: np.ndarray
    """(n, 3) [m]."""
    faces: np.ndarray
    """Triangles, counter-clockwise as seen from its front, (F, 3)."""


@dataclass(frozen=True)
class Solid:
    """A rigid body, in the frame of the world."""

    vertices: np.ndarray
    """(n, 3) [m]."""
    faces: np.ndarray
    """Triangles, counter-clockwise as seen from outside, (F, 3)."""
    color: palette.Color = palette.SOLID
    """What it looks like."""


@dataclass(frozen=True)
class Line:
    """A mark that is no part of the world, such as an axis or a crease."""

    points: np.ndarray
    """(p, 3) [m]."""


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Everything visible in one world, in its own frame."""

    object: Tube | Sheet
    """The deformable object."""
    goal: Tube | Sheet | None = None
    """Where it should lie; drawn as a ghost, and not at all in observations."""
    solids: tuple[Solid, ...] = ()
    """Obstacles."""
    lines: tuple[Line, ...] = ()
    """Marks; drawn with the goal."""
    grippers: np.ndarray
    """Positions of the grippers, (A, 3) [m]."""
    closed: np.ndarray
    """Grippers that are closed, (A,) bool."""
    is_solved: bool
    """Whether the colour of success is shown."""
    has_table: bool = True
    """Whether there is a table, at z = 0."""
