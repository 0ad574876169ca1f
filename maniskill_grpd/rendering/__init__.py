"""Batched cameras without a graphics driver: depth, segmentation, positions, normals, colours and visible points, in Warp.

`B` worlds, `C` cameras in each, `V` vertices, `F` triangles, `M` variants of what is drawn, images of `H` x `W` pixels. Cameras
look along z with x right and y down (OpenCV). Knows numpy, torch, trimesh, Warp and the physics; knows nothing of gymnasium or
ManiSkill.
"""

from maniskill_grpd.rendering.cameras import Lens, extrinsic_from_pose, intrinsic_from_fov, look_at
from maniskill_grpd.rendering.labels import Label
from maniskill_grpd.rendering.rasterizer import Rasterizer
from maniskill_grpd.rendering.sensor_noise import DepthSensor
from maniskill_grpd.rendering.solver_scene import SolverScene
from maniskill_grpd.rendering.triangle_scene import TriangleScene

__all__ = [
    "DepthSensor",
    "Label",
    "Lens",
    "Rasterizer",
    "SolverScene",
    "TriangleScene",
    "extrinsic_from_pose",
    "intrinsic_from_fov",
    "look_at",
]
