"""Controllers that move each gripper by a displacement of limited length, and may open and close it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.controllers import PDJointPosController, PDJointPosControllerConfig


class DeltaPositionController(PDJointPosController):
    """Moves every gripper's target by `step_size * a`, with the 3-vector `a` limited to |a| <= 1.

    The limit is a ball. A limit per axis would be a cube: it changes the direction of a motion, and
    changes it differently in every orientation of the scene, so that no policy behind it could be
    equivariant. Targets that would enter the table stop at its surface.

    The targets live in the articulation (`drive_targets`), which the solver may correct; the
    controller has no copy of its own that could run away from them.
    """

    config: DeltaPositionControllerConfig

    def reset(self) -> None:
        """Do nothing: whoever resets a world places its grippers and their targets.

        The stock controller resets the targets of all worlds here, also of those that go on.
        """

    def set_action(self, action: torch.Tensor) -> None:
        """Move the targets by normalised displacements (B, 3 * A)."""
        articulation = self.articulation
        targets = articulation.drive_targets.unflatten(1, (-1, 3))
        targets = targets + self._displacements(action.unflatten(1, (-1, 3)))
        self.set_drive_targets(articulation.keep_above_floor(targets).flatten(1))

    def set_drive_targets(self, targets: torch.Tensor) -> None:
        """Hand targets (B, 3 * A) [m] to the articulation."""
        self.articulation.set_joint_drive_targets(targets)

    def before_simulation_step(self) -> None:
        """Do nothing: the grippers move to their targets within the one step of the solver."""

    def get_state(self) -> dict[str, torch.Tensor]:
        """Return a copy of the targets."""
        return {"target_qpos": self.articulation.drive_targets.clone()}

    def set_state(self, state: dict[str, torch.Tensor], env_idx: torch.Tensor | None = None) -> None:
        """Restore the targets of the worlds `env_idx` (b,), or of those being reset."""
        worlds = self.scene._reset_mask if env_idx is None else env_idx
        self.articulation.drive_targets[worlds] = state["target_qpos"].to(self.device)

    def _displacements(self, action: torch.Tensor) -> torch.Tensor:
        # float64: the square of a large but finite float32 action would overflow to a zero motion
        length = torch.linalg.vector_norm(action, dim=-1, keepdim=True, dtype=torch.float64)
        return action * (self.config.step_size / length.clamp_min_(1.0)).float()


@dataclass
class DeltaPositionControllerConfig(PDJointPosControllerConfig):
    """Configuration of `DeltaPositionController`; the joints of a gripper stand in a row: x, y, z.

    Attributes:
        step_size: Longest displacement of a gripper in one control step [m].
    """

    step_size: float = 0.03
    controller_cls = DeltaPositionController


class DeltaPositionGripController(DeltaPositionController):
    """Moves every gripper by the first three of its four numbers; it is closed while the fourth is > 0."""

    config: DeltaPositionGripControllerConfig

    def _initialize_action_space(self) -> None:
        super()._initialize_action_space()
        per_gripper = self.single_action_space.low.reshape(-1, 3), self.single_action_space.high.reshape(-1, 3)
        low, high = (np.pad(bound, ((0, 0), (0, 1)), constant_values=g) for bound, g in zip(per_gripper, (-1, 1), strict=True))
        self.single_action_space = spaces.Box(low.ravel(), high.ravel(), dtype=np.float32)

    def set_action(self, action: torch.Tensor) -> None:
        """Move the targets by normalised displacements and command the grip, (B, 4 * A)."""
        per_gripper = action.unflatten(1, (-1, 4))
        super().set_action(per_gripper[..., :3].flatten(1))
        self.articulation.command_grip(per_gripper[..., 3] > 0.0)


@dataclass
class DeltaPositionGripControllerConfig(DeltaPositionControllerConfig):
    """Configuration of `DeltaPositionGripController`."""

    controller_cls = DeltaPositionGripController
