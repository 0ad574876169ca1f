"""What every painter offers."""

from __future__ import annotations

from typing import Protocol

import torch

from maniskill_grpd.tasks.pictures.drawing import Drawing


class Painter(Protocol):
    """Shows one world at a time."""

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Set up the scene that is pictured next; observations do not show the goal."""

    def picture(self) -> torch.Tensor:
        """Return an image of what was shown last, (1, H, W, 3) uint8."""
