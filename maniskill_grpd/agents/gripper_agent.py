"""What all agents that drive grippers have in common."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import torch
from mani_skill.agents.base_agent import BaseAgent

from maniskill_grpd.agents.effectors import Effectors


class GripperAgent(BaseAgent):
    """An agent that drives grippers, whose bodies are `robot`.

    Several agents may share a scene: each takes the next grippers that are free
    (`BatchedScene.claim_grippers`).
    """

    num_grippers: int
    robot: Effectors
    NUMBERS_PER_GRIPPER: ClassVar[dict[str, int]]
    """Numbers of the action per gripper, by the name of the control mode."""

    @property
    def body_name(self) -> str:
        """Name of `robot` in the state dictionary: that of the agent, numbered where there are several."""
        return self.uid if self._agent_idx is None else f"{self.uid}-agent-{self._agent_idx}"

    def set_action(self, action: torch.Tensor) -> None:
        """Check an action (B, numbers per gripper * A) and hand it to the controller.

        Raises:
            ValueError: If its shape is wrong or a value is not finite. Nothing has moved then.
        """
        self.controller.set_action(self._checked(action))

    def _checked(self, action: torch.Tensor) -> torch.Tensor:
        per_gripper = self.NUMBERS_PER_GRIPPER[self.control_mode]
        width = per_gripper * self.num_grippers
        expected = (self.scene.num_envs, width)
        if tuple(action.shape) != expected:
            allowed = f"{expected} or {(width,)}" if expected[0] == 1 else f"{expected}"
            raise ValueError(f"action of {self.uid} must have shape {allowed}, got {tuple(action.shape)}")
        action = action.detach().to(device=self.device, dtype=torch.float32)
        if not torch.isfinite(action).all():
            world, column = np.argwhere(~torch.isfinite(action).cpu().numpy())[0]
            raise ValueError(
                "action must be finite (values beyond [-1, 1] are limited by the length of each "
                f"gripper's vector), got {action[world, column].item()} in world {world} "
                f"for gripper {column // per_gripper}"
            )
        return action
