"""Floating grippers: point-like hands with three translational degrees of freedom each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from mani_skill.agents.base_agent import BaseAgent
from mani_skill.agents.registration import register_agent

from maniskill_grpd.agents.delta_position_controller import DeltaPositionControllerConfig, DeltaPositionGripControllerConfig
from maniskill_grpd.agents.kinematic_articulation import KinematicArticulation

if TYPE_CHECKING:
    import sapien

STEP_SIZE = 0.03
"""Longest displacement of a gripper in one control step [m]: 0.6 m/s at 20 Hz."""
NUMBERS_PER_GRIPPER = {"pd_ee_delta_pos": 3, "pd_ee_delta_pos_grip": 4}
"""Numbers of the action per gripper, by the name of the control mode; the first is the default."""


class FloatingGrippers(BaseAgent):
    """A grippers that float freely, driven together as one agent.

    Control modes, actions normalised to [-1, 1]:
        pd_ee_delta_pos       Box (3 * A,): one 3-vector in the world frame per gripper, limited to
                              length 1 and scaled to 3 cm per control step. Grippers stay as they are.
        pd_ee_delta_pos_grip  Box (4 * A,): per gripper such a vector, then the grip: closed while > 0.

    Several agents may share a scene: each takes the next grippers that are free
    (`BatchedScene.claim_grippers`).
    """

    num_grippers: int

    def _load_articulation(self, initial_pose: sapien.Pose | None = None) -> None:
        solver, mine = self.scene.solver, self.scene.claim_grippers(self.num_grippers)
        name = self.uid if self._agent_idx is None else f"{self.uid}-agent-{self._agent_idx}"
        self.robot = KinematicArticulation(
            self.scene,
            name,
            positions=solver.gripper_positions[:, mine],
            targets=solver.gripper_targets[:, mine],
            grip_commands=self.scene.grip_commands[:, mine],
        )
        self.robot_link_names = list(self.robot.links_map)
        self.scene.state_dict_registry.articulations[name] = self.robot

    @property
    def _controller_configs(self) -> dict[str, DeltaPositionControllerConfig]:
        # Gains are required by ManiSkill and ignored by kinematic joints.
        settings = {
            "joint_names": [joint.name for joint in self.robot.active_joints],
            "lower": -STEP_SIZE,
            "upper": STEP_SIZE,
            "stiffness": 0.0,
            "damping": 0.0,
            "use_delta": True,
            "use_target": True,
            "step_size": STEP_SIZE,
        }
        return {
            "pd_ee_delta_pos": DeltaPositionControllerConfig(**settings),
            "pd_ee_delta_pos_grip": DeltaPositionGripControllerConfig(**settings),
        }

    def set_action(self, action: torch.Tensor) -> None:
        """Check an action (B, 3 * A) or (B, 4 * A) and hand it to the controller.

        Raises:
            ValueError: If its shape is wrong or a value is not finite. Nothing has moved then.
        """
        self.controller.set_action(self._checked(action))

    def _checked(self, action: torch.Tensor) -> torch.Tensor:
        width = NUMBERS_PER_GRIPPER[self.control_mode] * self.num_grippers
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
                f"for gripper {column // NUMBERS_PER_GRIPPER[self.control_mode]}"
            )
        return action


@register_agent()
class FloatingGrippers1(FloatingGrippers):
    """One floating gripper."""

    uid = "floating_grippers_1"
    num_grippers = 1


@register_agent()
class FloatingGrippers2(FloatingGrippers):
    """Two floating grippers."""

    uid = "floating_grippers_2"
    num_grippers = 2


@register_agent()
class FloatingGrippers3(FloatingGrippers):
    """Three floating grippers."""

    uid = "floating_grippers_3"
    num_grippers = 3


@register_agent()
class FloatingGrippers4(FloatingGrippers):
    """Four floating grippers."""

    uid = "floating_grippers_4"
    num_grippers = 4
