"""Deformable tasks for ManiSkill; importing this package registers them."""

from maniskill_grpd.tasks.check_task import check_task
from maniskill_grpd.tasks.cloth_folding import ClothFoldingEnv
from maniskill_grpd.tasks.cloth_hanging import ClothHangingEnv
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.geometry.cloth_shapes import CLOTH_SHAPES, register_cloth_shape
from maniskill_grpd.tasks.geometry.goal_shapes import GOAL_SHAPES, goal_curve, register_goal_shape
from maniskill_grpd.tasks.measurement import GoalMeasurement, Measurement, Metric
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.pictures.drawing import Drawing, Line, Sheet, Solid, Tube
from maniskill_grpd.tasks.rope_shaping import RopeShapingEnv
from maniskill_grpd.tasks.rope_wrapping import RopeWrappingEnv

__all__ = [
    "CLOTH_SHAPES",
    "GOAL_SHAPES",
    "ClothFoldingEnv",
    "ClothHangingEnv",
    "DeformableEnv",
    "Drawing",
    "GoalMeasurement",
    "Line",
    "Measurement",
    "Metric",
    "RopeShapingEnv",
    "RopeWrappingEnv",
    "Sheet",
    "Solid",
    "Tube",
    "channels",
    "check_task",
    "goal_curve",
    "register_cloth_shape",
    "register_goal_shape",
]
