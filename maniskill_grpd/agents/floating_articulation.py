"""Floating grippers as one articulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from maniskill_grpd.agents.kinematic_articulation import KinematicArticulation

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene

AXES = "xyz"


class FloatingArticulation(KinematicArticulation):
    """Grippers as one articulation of 3 * A prismatic joints that reach their drive targets.

    Attributes:
        qpos: Gripper positions in the world frame, (B, 3 * A) [m].
        qvel: Displacement of the last control step over its duration, (B, 3 * A) [m/s].

    Limitations: no links but a root without pose, no orientation.
    """

    def __init__(
        self, scene: ManiSkillScene, name: str, *, positions: torch.Tensor, targets: torch.Tensor, grip_commands: torch.Tensor
    ) -> None:
        """Wrap gripper tensors, see `KinematicArticulation`."""
        joints = [f"gripper_{index}_{axis}" for index in range(positions.shape[1]) for axis in AXES]
        views = {"positions": positions, "targets": targets, "grip_commands": grip_commands}
        super().__init__(scene, name, **views, joints=joints, links=["root"])
        self.qpos = positions.view(len(positions), -1)
        self.qvel = self.velocities.view(len(positions), -1)

    def get_qpos(self) -> torch.Tensor:
        """Return a copy of `qpos`."""
        return self.qpos.clone()

    def get_qvel(self) -> torch.Tensor:
        """Return a copy of `qvel`."""
        return self.qvel.clone()

    def get_qlimits(self) -> torch.Tensor:
        """Return joint limits (B, 3 * A, 2) [m]: floating grippers have none."""
        limits = torch.tensor([-torch.inf, torch.inf], device=self.device)
        return limits.expand(len(self.qpos), self.max_dof, 2)

    def set_qpos(self, qpos: torch.Tensor) -> None:
        """Move the grippers of the worlds being reset; rows (b, 3 * A) or one row for all [m]."""
        self._write(self.qpos, qpos)

    def set_qvel(self, qvel: torch.Tensor) -> None:
        """Set the velocities of the worlds being reset; rows (b, 3 * A) or one for all [m/s]."""
        self._write(self.qvel, qvel)

    def get_state(self) -> torch.Tensor:
        """Return root pose and velocity (constant), qpos and qvel, (B, 13 + 6 * A)."""
        root = torch.zeros(len(self.qpos), 13, device=self.device)
        root[:, 3] = 1.0  # quaternion (w, x, y, z) of no rotation
        return torch.cat([root, self.qpos, self.qvel], dim=1)

    def set_state(self, state: torch.Tensor, env_idx: torch.Tensor | None = None) -> None:
        """See `KinematicArticulation.set_state`."""
        rows, worlds = self._state_rows(state, env_idx)
        self.qpos[worlds], self.qvel[worlds] = rows[:, 13:].split(self.max_dof, dim=1)
