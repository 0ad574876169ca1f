"""Arms that hold an object at their TCPs, batched on CPU and CUDA."""

from maniskill_grpd.agents.arms.arm_agent import ARM_MODES, ArmAgent
from maniskill_grpd.agents.arms.arm_articulation import ArmArticulation
from maniskill_grpd.agents.arms.arm_bodies import ArmBodies
from maniskill_grpd.agents.arms.arm_description import ARMS, ArmDescription, register_arm
from maniskill_grpd.agents.arms.capsules import arm_links

__all__ = ["ARMS", "ARM_MODES", "ArmAgent", "ArmArticulation", "ArmBodies", "ArmDescription", "arm_links", "register_arm"]
