"""Deformable tasks for ManiSkill; importing this package registers them."""

from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.goal_shapes import GOAL_SHAPES, goal_curve
from maniskill_grpd.tasks.rope_shaping import RopeShapingEnv
from maniskill_grpd.tasks.rope_wrapping import RopeWrappingEnv

__all__ = ["GOAL_SHAPES", "DeformableEnv", "RopeShapingEnv", "RopeWrappingEnv", "goal_curve"]
