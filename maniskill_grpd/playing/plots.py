"""Live plots of the last steps."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import torch

from maniskill_grpd.playing.player import Moment

LENGTH = 200
"""Steps that plots show."""
PERIOD = 4
"""Steps from one drawing to the next."""
PLOTS = {"reward": "#d9541e", "solved": "#17b04a", "length of actions": "#2e6bed"}
"""What is plotted, means over the worlds, and in which colour."""


class Plots:
    """Reward, share of solved worlds and mean length of actions over time.

    Args:
        gui: Where they are drawn.
    """

    def __init__(self, gui: Any) -> None:
        self._values: deque[tuple[float, ...]] = deque(maxlen=LENGTH)
        self._count = 0
        self._handles = [
            gui.add_uplot(
                self._data(index),
                series=({"label": "step"}, {"label": name, "stroke": color, "width": 2}),
                title=name,
                scales={"x": {"time": False}},
                legend={"show": False},
                height=120,
            )
            for index, (name, color) in enumerate(PLOTS.items())
        ]

    def add(self, moment: Moment) -> None:
        """Append a step."""
        lengths = torch.linalg.vector_norm(moment.action, dim=-1)
        means = (float(values.float().mean()) for values in (moment.reward, moment.success, lengths))
        self._values.append((float(moment.step), *means))
        self._count += 1
        if self._count % PERIOD == 0:
            self._draw()

    def clear(self) -> None:
        """Begin anew."""
        self._values.clear()
        self._draw()

    def _draw(self) -> None:
        for index, handle in enumerate(self._handles):
            handle.data = self._data(index)

    def _data(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        rows = np.array(self._values) if self._values else np.zeros((1, 1 + len(PLOTS)))
        return rows[:, 0], rows[:, 1 + index]
