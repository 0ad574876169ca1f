"""Controllers of arms, by the names of ManiSkill's control modes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import torch
from gymnasium import spaces
from mani_skill.agents.controllers.base_controller import BaseController, ControllerConfig

from maniskill_grpd.agents.arms.arm_articulation import ArmArticulation

LIMIT_TOLERANCE = 1e-5
"""By how much a joint target may be out of its limits by rounding [rad]."""


class ArmController(BaseController):
    """What all of them share: an action of some numbers, and perhaps one more for the grip, which is closed while > 0."""

    config: ArmControllerConfig
    articulation: ArmArticulation
    holds_rotation = False
    size: ClassVar[int | None] = None
    """Numbers of the action without the grip; None for one per joint."""

    def set_drive_property(self) -> None:
        """Let the hand turn freely or keep its rotation; gains mean nothing to kinematic joints."""
        arm = self.articulation.arm
        self.articulation.bodies.hold_rotation(slice(arm, arm + 1), self.holds_rotation)

    def reset(self) -> None:
        """Do nothing: whoever resets a world places its arms and their targets."""

    def set_action(self, action: torch.Tensor) -> None:
        """Command the arm, and the grip where the mode has it, (B, numbers)."""
        if self.config.has_grip:
            action, grip = action[:, :-1], action[:, -1:]
        self.command(action)
        if self.config.has_grip:
            self.articulation.command_grip(grip > 0.0)

    def command(self, action: torch.Tensor) -> None:
        """Command the arm alone."""
        raise NotImplementedError

    def get_state(self) -> dict[str, torch.Tensor]:
        """Return a copy of the target of the TCP, which the solver's state has too."""
        return {"target_pos": self.articulation.drive_targets.clone()}

    def set_state(self, state: dict[str, torch.Tensor], env_idx: torch.Tensor | None = None) -> None:
        """Restore the targets of the worlds `env_idx` (b,), or of those being reset."""
        worlds = self.scene._reset_mask if env_idx is None else env_idx
        self.articulation.drive_targets[worlds] = state["target_pos"].to(self.device)

    def _initialize_action_space(self) -> None:
        low, high = self._bounds()
        grip = 1 if self.config.has_grip else 0
        low, high = np.append(low, [-1.0] * grip), np.append(high, [1.0] * grip)
        self.single_action_space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return -np.ones(self.num_numbers), np.ones(self.num_numbers)

    @property
    def num_numbers(self) -> int:
        """Numbers of the action without the grip."""
        return self.size_for(self.articulation.num_arm_joints)

    @classmethod
    def size_for(cls, num_joints: int) -> int:
        """Return these for an arm of so many joints."""
        return num_joints if cls.size is None else cls.size


class PointController(ArmController):
    """pd_ee_delta_pos: moves the TCP by `step_size * a` with |a| <= 1, as `DeltaPositionController`; the hand turns freely."""

    size = 3

    def command(self, action: torch.Tensor) -> None:
        """See `ArmController`."""
        self.articulation.command_point(_in_ball(action, self.config.step_size))


class PoseController(ArmController):
    """pd_ee_delta_pose: as before, and turns the hand in the world by `turn_size * a` of the next three numbers, |a| <= 1."""

    size = 6
    holds_rotation = True

    def command(self, action: torch.Tensor) -> None:
        """See `ArmController`."""
        move, turn = action[:, :3], action[:, 3:]
        self.articulation.command_point(_in_ball(move, self.config.step_size), _in_ball(turn, self.config.turn_size))


class JointDeltaController(ArmController):
    """pd_joint_delta_pos: moves each joint by `turn_size * a`, |a| <= 1."""

    def command(self, action: torch.Tensor) -> None:
        """See `ArmController`."""
        self.articulation.command_joints(self.articulation.qpos + action.clamp(-1.0, 1.0) * self.config.turn_size)


class JointController(ArmController):
    """pd_joint_pos: tells the joints where to go [rad]; the action is not normalised."""

    def command(self, action: torch.Tensor) -> None:
        """See `ArmController`.

        Raises:
            ValueError: If a target is out of the limits of its joint. Nothing has moved then.
        """
        low, high = (torch.as_tensor(bound, device=action.device) for bound in self._bounds())
        outside = (action < low - LIMIT_TOLERANCE) | (action > high + LIMIT_TOLERANCE)
        if outside.any():
            world, joint = outside.nonzero()[0].tolist()
            name = self.articulation.description.arm_joints[joint].name
            raise ValueError(
                f"targets of {name} must be in [{low[joint]:.4f}, {high[joint]:.4f}] rad, got {action[world, joint]:.4f} "
                f"in world {world}"
            )
        self.articulation.command_joints(action)

    def _bounds(self) -> tuple[np.ndarray, np.ndarray]:
        limits = self.articulation.get_qlimits()[0, : self.num_numbers].cpu().numpy()
        return limits[:, 0], limits[:, 1]


@dataclass
class ArmControllerConfig(ControllerConfig):
    """Configuration of the controllers of arms."""

    controller_cls: type[ArmController] = PointController
    step_size: float = 0.0
    """Longest displacement of the TCP in one control step [m]."""
    turn_size: float = 0.0
    """Largest turn of the hand, or of a joint, in one control step [rad]."""
    has_grip: bool = False
    """Whether the last number opens and closes the hand."""


def _in_ball(vectors: torch.Tensor, size: float) -> torch.Tensor:
    """Scale vectors (B, 3), shortened to length 1, by a size: to the bit as the controller of floating grippers does."""
    length = torch.linalg.vector_norm(vectors, dim=-1, keepdim=True, dtype=torch.float64)
    return vectors * (size / length.clamp_min_(1.0)).float()
