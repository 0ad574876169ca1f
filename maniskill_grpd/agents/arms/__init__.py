"""Arms that hold an object at their TCPs, batched on CPU and CUDA."""

from maniskill_grpd.agents.arms.arm_bodies import ArmBodies
from maniskill_grpd.agents.arms.arm_description import ARMS, ArmDescription, register_arm

__all__ = ["ARMS", "ArmBodies", "ArmDescription", "register_arm"]
