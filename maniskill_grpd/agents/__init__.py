"""Floating grippers and arms as ManiSkill agents; importing this package registers them."""

from maniskill_grpd.agents.arms import ARMS, ArmAgent, ArmBodies, ArmDescription, register_arm
from maniskill_grpd.agents.delta_position_controller import (
    DeltaPositionController,
    DeltaPositionControllerConfig,
    DeltaPositionGripController,
    DeltaPositionGripControllerConfig,
)
from maniskill_grpd.agents.effectors import Effectors
from maniskill_grpd.agents.floating_articulation import FloatingArticulation
from maniskill_grpd.agents.floating_grippers import FloatingGrippers
from maniskill_grpd.agents.gripper_agent import GripperAgent
from maniskill_grpd.agents.kinematic_articulation import KinematicArticulation

__all__ = [
    "ARMS",
    "ArmAgent",
    "ArmBodies",
    "ArmDescription",
    "DeltaPositionController",
    "DeltaPositionControllerConfig",
    "DeltaPositionGripController",
    "DeltaPositionGripControllerConfig",
    "Effectors",
    "FloatingArticulation",
    "FloatingGrippers",
    "GripperAgent",
    "KinematicArticulation",
    "register_arm",
]
