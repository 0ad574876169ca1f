"""Arms as solids to draw."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from maniskill_grpd.agents.arms import ArmArticulation
from maniskill_grpd.agents.arms.capsules import shape_mesh
from maniskill_grpd.agents.arms.urdf import Shape, transform
from maniskill_grpd.tasks.pictures.drawing import Solid


def arm_solids(arm: ArmArticulation, world: int) -> tuple[Solid, ...]:
    """Return the links of an arm in one world: the meshes with which it would collide, which have few triangles."""
    base = arm.bodies.bases[world, arm.arm].cpu().double().numpy()
    names = [joint.name for joint in arm.joints]
    qpos = dict(zip(names, arm.get_qpos()[world].tolist(), strict=True))
    root = transform(Rotation.from_quat(base[3:]).as_matrix(), base[:3])
    frames = arm.description.robot.frames(root, qpos)
    return tuple(_placed(shape, frames[link]) for link, shapes in arm.description.robot.shapes.items() for shape in shapes)


def _placed(shape: Shape, frame: np.ndarray) -> Solid:
    vertices, faces = shape_mesh(shape)
    return Solid(vertices @ frame[:3, :3].T + frame[:3, 3], faces)
