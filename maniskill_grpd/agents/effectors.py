"""What worlds ask of the bodies that hold an object, whatever they are."""

from __future__ import annotations

from typing import Protocol

import torch


class Effectors(Protocol):
    """The n grippers of one agent, in B worlds: floating ones, or the tools of arms.

    Where they are and where they are to be is in the tensors of the solver, of which each agent has claimed a part; nobody has
    a copy.
    """

    name: str
    """Name in the state dictionary."""

    @property
    def velocities(self) -> torch.Tensor:
        """Displacements of the grippers in the last control step over its duration, (B, n, 3) [m/s]."""

    def set_floor(self, plane: torch.Tensor, clearance: float) -> None:
        """Let targets keep `clearance` [m] from the surface n . x = c of `plane` (B, 4) = (n, c), which is kept, not copied."""

    def place(self, worlds: torch.Tensor) -> None:
        """Bring the grippers of some worlds (b,) to rest where the solver has put them."""

    def start_motion(self) -> None:
        """Be told that a control step begins."""

    def finish_motion(self, duration: float) -> None:
        """Be told that a control step of `duration` [s] is over."""

    def move(self, rotation: torch.Tensor, translation: torch.Tensor) -> None:
        """Move with the worlds, x -> R x + t; rotations (B, 3, 3), translations (B, 3) [m]."""

    def get_state(self) -> torch.Tensor:
        """Return what is in no tensor of the solver, (B, D)."""

    def set_state(self, state: torch.Tensor, env_idx: torch.Tensor | None = None) -> None:
        """Restore rows of `get_state` for the worlds `env_idx` (b,), or for those being reset."""
