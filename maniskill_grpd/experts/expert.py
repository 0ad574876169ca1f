"""What every expert offers."""

from __future__ import annotations

import abc
from typing import Any, ClassVar

import torch

from maniskill_grpd.tasks import DeformableEnv


class Expert(abc.ABC):
    """Acts from the state of the simulation, without learning and without memory.

    The action is a function of the present state of each world alone. An expert therefore needs no
    reset, may join an episode at any step and answers in states it would never have come to, which
    is what imitation learning with disturbed demonstrations asks of it.

    Attributes:
        task: Class of the environments it acts in.

    Args:
        env: The environment, plain or wrapped.
    """

    task: ClassVar[type[DeformableEnv]]

    def __init__(self, env: Any) -> None:
        self.env: DeformableEnv = env.unwrapped

    @abc.abstractmethod
    def act(self) -> torch.Tensor:
        """Return the action for the present state, (B, A * 3), each gripper's part of norm <= 1."""
