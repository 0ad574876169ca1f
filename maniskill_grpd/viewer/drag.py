"""What clients do with the mouse on a part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np


@dataclass(frozen=True)
class Drag:
    """A client takes hold of a part, pulls at it, or lets it go."""

    client: int
    """Number of the client."""
    phase: Literal["start", "update", "end"]
    """Taken hold of, pulled, or let go."""
    hit: np.ndarray
    """Where the part was taken hold of, (3,) [m] in the scene; it moves with the part."""
    pointer: np.ndarray
    """Where it is pulled to, (3,) [m]."""
