"""Deformable tasks for ManiSkill; importing this package registers them."""

from maniskill_grpd.tasks.cloth_folding import ClothFoldingEnv
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.goal_shapes import GOAL_SHAPES, goal_curve
from maniskill_grpd.tasks.rope_shaping import RopeShapingEnv

__all__ = ["GOAL_SHAPES", "ClothFoldingEnv", "DeformableEnv", "RopeShapingEnv", "goal_curve"]
