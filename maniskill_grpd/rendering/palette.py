"""Colours and light of all pictures; sRGB in [0, 1]."""

from __future__ import annotations

import numpy as np

Color = tuple[float, float, float]

BACKGROUND = (0.975, 0.972, 0.962)
TABLE = (0.872, 0.880, 0.892)
SHADOW_DARKNESS = 0.30
"""Share of the light of the table that is missing in a shadow."""
TABLE_LINES = (0.800, 0.812, 0.830)
FRONT = (0.890, 0.420, 0.225)
"""Ropes, and the front of cloth."""
BACK = (0.985, 0.790, 0.400)
SOLID = (0.480, 0.520, 0.570)
ARM = (0.900, 0.905, 0.915)
GOAL = (0.180, 0.420, 0.930)
SOLVED = (0.090, 0.690, 0.290)
CLOSED_GRIPPER = (0.120, 0.150, 0.330)
OPEN_GRIPPER = (0.560, 0.650, 0.900)

LIGHT_DIRECTION = np.array([-0.45, -0.30, 0.84]) / np.linalg.norm([-0.45, -0.30, 0.84])
"""Towards the light, (3,), unit."""
