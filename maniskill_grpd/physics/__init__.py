"""Batched XPBD physics of ropes and cloth in NVIDIA Warp.

World-local coordinates, SI units, float32, right-handed with gravity as a per-world vector; quaternions are (w, x, y, z). `B`
worlds, `N` nodes, `A` grippers, `K` colliders, `M` variants of the object. Knows numpy, scipy, trimesh, torch and Warp; knows
nothing of gymnasium or ManiSkill.
"""

from maniskill_grpd.physics.cloth import ClothMaterial, cloth, cloth_from_file, cloth_from_mesh
from maniskill_grpd.physics.colliders import Collider, box, capsule, cylinder, plane, prism, sphere, triangle_mesh
from maniskill_grpd.physics.fields import STANDARD_GRAVITY
from maniskill_grpd.physics.links import Link
from maniskill_grpd.physics.mesh.curves import resample_polyline
from maniskill_grpd.physics.mesh.outlines import (
    circle_outline,
    hexagon_outline,
    l_shape_outline,
    rectangle_outline,
    square_outline,
    triangle_outline,
)
from maniskill_grpd.physics.model import Model
from maniskill_grpd.physics.rope import RopeMaterial, rope
from maniskill_grpd.physics.solver import Solver

__all__ = [
    "STANDARD_GRAVITY",
    "ClothMaterial",
    "Collider",
    "Link",
    "Model",
    "RopeMaterial",
    "Solver",
    "box",
    "capsule",
    "circle_outline",
    "cloth",
    "cloth_from_file",
    "cloth_from_mesh",
    "cylinder",
    "hexagon_outline",
    "l_shape_outline",
    "plane",
    "prism",
    "rectangle_outline",
    "resample_polyline",
    "rope",
    "sphere",
    "square_outline",
    "triangle_mesh",
    "triangle_outline",
]
