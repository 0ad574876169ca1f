"""Arms as ManiSkill agents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch

from maniskill_grpd.agents.arms.arm_articulation import ArmArticulation
from maniskill_grpd.agents.arms.arm_controllers import (
    ArmControllerConfig,
    JointController,
    JointDeltaController,
    PointController,
    PoseController,
)
from maniskill_grpd.agents.arms.arm_description import ArmDescription
from maniskill_grpd.agents.floating_grippers import STEP_SIZE
from maniskill_grpd.agents.gripper_agent import GripperAgent

if TYPE_CHECKING:
    import sapien

TURN_SIZE = 0.1
"""Largest turn of a hand or a joint in one control step [rad], as in ManiSkill's modes of these names."""
ARM_MODES = {
    "pd_ee_delta_pos": PointController,
    "pd_ee_delta_pose": PoseController,
    "pd_joint_delta_pos": JointDeltaController,
    "pd_joint_pos": JointController,
}
"""Controllers by the name of the control mode, the default first; "_grip" behind a name adds a number for the grip."""


class ArmAgent(GripperAgent):
    """An arm that holds the object at its TCP.

    Control modes, in the world frame and with the ranges of ManiSkill where nothing else is said:
        pd_ee_delta_pos     Box (3,): displacement of the TCP, limited to length 1 and scaled to 3 cm, as that of a floating
                            gripper; the hand turns freely about the TCP.
        pd_ee_delta_pose    Box (6,): then a turn of the hand, axis-angle, limited to length 1 and scaled to 0.1 rad.
        pd_joint_delta_pos  Box (J,): change of each joint, scaled to 0.1 rad.
        pd_joint_pos        Box (J,): joint positions [rad], not normalised.
        <mode>_grip         one more number: the hand is closed while > 0.
    """

    num_grippers = 1
    robot: ArmArticulation

    def __init__(self, description: ArmDescription, scene: Any, *args: Any, **settings: Any) -> None:
        """Make the agent of the next arm of `scene.arms`, which must fit the description."""
        self.uid = description.uid
        self.description = description
        own = len(description.arm_joints)
        numbers = {mode: controller.size_for(own) for mode, controller in ARM_MODES.items()}
        self.NUMBERS_PER_GRIPPER = numbers | {f"{mode}_grip": number + 1 for mode, number in numbers.items()}
        super().__init__(scene, *args, **settings)

    def _load_articulation(self, initial_pose: sapien.Pose | None = None) -> None:
        arm = self.scene.claim_grippers(1).start
        self.robot = ArmArticulation(self.scene, self.body_name, self.scene.arms, arm)
        self.robot_link_names = list(self.robot.links_map)
        self.scene.state_dict_registry.articulations[self.body_name] = self.robot

    @property
    def _controller_configs(self) -> dict[str, ArmControllerConfig]:
        return {
            mode + suffix: ArmControllerConfig(
                joint_names=[joint.name for joint in self.description.arm_joints],
                controller_cls=controller,
                step_size=STEP_SIZE,
                turn_size=TURN_SIZE,
                has_grip=bool(suffix),
            )
            for mode, controller in ARM_MODES.items()
            for suffix in ("", "_grip")
        }

    @property
    def tcp_pose(self) -> torch.Tensor:
        """Position [m] and quaternion (w, x, y, z) of the tool in the world, (B, 7)."""
        return self.robot.tcp_pose

    def get_proprioception(self) -> dict[str, Any]:
        """Return joint positions and velocities, the pose of the tool and the target, each (B, D)."""
        return {**super().get_proprioception(), "tcp_pose": self.tcp_pose}
