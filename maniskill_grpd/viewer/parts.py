"""What there is to see, in parts that are drawn in one way: meshes that change their form, and rigid ones that move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Color = tuple[float, float, float]
"""sRGB in [0, 1]."""


@dataclass(frozen=True)
class Look:
    """How a mesh is drawn."""

    front: Color
    """Colour of the sides from which faces are counter-clockwise."""
    back: Color | None = None
    """Colour of the other sides; that of the front by default."""
    opacity: float = 1.0
    """1 hides what is behind."""
    is_flat: bool = False
    """Whether faces are shaded each for itself."""
    is_backdrop: bool = False
    """Whether a camera that shows everything need not show this."""


@dataclass(frozen=True)
class Shell:
    """A mesh whose vertices move each for itself."""

    vertices: np.ndarray
    """(n, 3) float32 [m]."""
    faces: np.ndarray
    """(F, 3) int."""
    look: Look


@dataclass(frozen=True)
class Copies:
    """A rigid mesh, wherever it is."""

    vertices: np.ndarray
    """In the frame of a copy, (n, 3) float32 [m]."""
    faces: np.ndarray
    """(F, 3) int."""
    look: Look
    positions: np.ndarray
    """Where each copy is, (m, 3) float32 [m]."""
    rotations: np.ndarray
    """Unit quaternion (w, x, y, z) of each copy, (m, 4) float32."""


Part = Shell | Copies


def same_mesh(one: Part, other: Part) -> bool:
    """Return whether two parts differ at most in where they are: a renderer can keep what it has built."""
    if type(one) is not type(other) or one.look != other.look or not same_array(one.faces, other.faces):
        return False
    if isinstance(one, Shell):
        return one.vertices.shape == other.vertices.shape
    return same_array(one.vertices, other.vertices) and len(one.positions) == len(other.positions)


def same_array(one: np.ndarray, other: np.ndarray) -> bool:
    """Return whether two arrays hold the same, at once where they are the same."""
    return one is other or np.array_equal(one, other)
