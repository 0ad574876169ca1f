"""Floating grippers: point-like hands with three translational degrees of freedom each."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mani_skill.agents.registration import register_agent

from maniskill_grpd.agents.delta_position_controller import DeltaPositionControllerConfig, DeltaPositionGripControllerConfig
from maniskill_grpd.agents.floating_articulation import FloatingArticulation
from maniskill_grpd.agents.gripper_agent import GripperAgent

if TYPE_CHECKING:
    import sapien

STEP_SIZE = 0.03
"""Longest displacement of a gripper in one control step [m]: 0.6 m/s at 20 Hz."""
NUMBERS_PER_GRIPPER = {"pd_ee_delta_pos": 3, "pd_ee_delta_pos_grip": 4}
"""Numbers of the action per gripper, by the name of the control mode; the first is the default."""


class FloatingGrippers(GripperAgent):
    """A grippers that float freely, driven together as one agent.

    Control modes, actions normalised to [-1, 1]:
        pd_ee_delta_pos       Box (3 * A,): one 3-vector in the world frame per gripper, limited to
                              length 1 and scaled to 3 cm per control step. Grippers stay as they are.
        pd_ee_delta_pos_grip  Box (4 * A,): per gripper such a vector, then the grip: closed while > 0.
    """

    robot: FloatingArticulation
    NUMBERS_PER_GRIPPER = NUMBERS_PER_GRIPPER

    def _load_articulation(self, initial_pose: sapien.Pose | None = None) -> None:
        solver, mine = self.scene.solver, self.scene.claim_grippers(self.num_grippers)
        self.robot = FloatingArticulation(
            self.scene,
            self.body_name,
            positions=solver.gripper_positions[:, mine],
            targets=solver.gripper_targets[:, mine],
            grip_commands=self.scene.grip_commands[:, mine],
        )
        self.robot_link_names = list(self.robot.links_map)
        self.scene.state_dict_registry.articulations[self.body_name] = self.robot

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
