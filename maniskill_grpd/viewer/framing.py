"""Where to look at a scene from."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from maniskill_grpd.viewer.parts import Part, Shell

MARGIN = 1.0
"""Distance of the camera over that from which everything just fits."""
HALF_VIEW = 0.4
"""Half the vertical field of view of viewers [rad]."""
SMALLEST = 0.15
"""Radius of the smallest scene that fills the picture [m]."""

View = tuple[np.ndarray, np.ndarray]
"""Where somebody stands and looks, (3,) each [m]."""


def frame(parts: Iterable[Part], towards: np.ndarray) -> View:
    """Return from where all parts but backdrops are seen in the middle of the picture.

    Args:
        parts: What there is to see, perhaps at several times.
        towards: Direction from the scene to the viewer, (3,).
    """
    corners = np.concatenate([_bounds(part) for part in parts if not part.look.is_backdrop])
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, radius = (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, SMALLEST)
    return middle + np.asarray(towards) / np.linalg.norm(towards) * (MARGIN * radius / np.sin(HALF_VIEW)), middle


def _bounds(part: Part) -> np.ndarray:
    """Return two opposite corners of a box that holds a part, (2, 3) [m]."""
    if isinstance(part, Shell):
        return np.stack([part.vertices.min(axis=0), part.vertices.max(axis=0)])
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    if np.abs(part.rotations[:, 1:]).max(initial=0.0) > 0.0:
        high = np.full(3, np.linalg.norm(part.vertices, axis=1).max())
        low = -high
    return np.stack([part.positions.min(axis=0) + low, part.positions.max(axis=0) + high])
