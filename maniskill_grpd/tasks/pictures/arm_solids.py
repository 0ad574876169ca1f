"""Arms as solids to draw, in one world and in all."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from mani_skill.utils.geometry.rotation_conversions import matrix_to_quaternion

from maniskill_grpd.agents.arms import ArmArticulation
from maniskill_grpd.agents.arms.link_frames import link_frames
from maniskill_grpd.agents.arms.meshes import picture_mesh
from maniskill_grpd.agents.arms.urdf import Shape
from maniskill_grpd.rendering import palette
from maniskill_grpd.rendering.bodies import mesh_body
from maniskill_grpd.rendering.labels import Label
from maniskill_grpd.rendering.solver_scene import RigidBodies
from maniskill_grpd.tasks.pictures.drawing import Solid


def arm_solids(arm: ArmArticulation, world: int) -> tuple[Solid, ...]:
    """Return the links of an arm in one world."""
    frames = {name: frame[world].cpu().double().numpy() for name, frame in link_frames(arm).items()}
    solids = []
    for link, shape in _shapes(arm):
        vertices, faces = picture_mesh(shape)
        frame = frames[link]
        solids.append(Solid(vertices @ frame[:3, :3].T + frame[:3, 3], faces, palette.ARM))
    return tuple(solids)


def arm_bodies(arms: Sequence[ArmArticulation]) -> RigidBodies:
    """Return the links of all arms as the rasteriser takes them."""
    look = (Label.ARM, palette.ARM, palette.ARM)
    bodies = [(mesh_body(*picture_mesh(shape)), look) for arm in arms for _, shape in _shapes(arm)]

    def place() -> tuple[torch.Tensor, torch.Tensor]:
        frames = [frames[link] for arm in arms for frames in [link_frames(arm)] for link, _ in _shapes(arm)]
        matrices = torch.stack(frames, dim=1)
        return matrices[..., :3, 3], matrix_to_quaternion(matrices[..., :3, :3])

    return RigidBodies(bodies, place)


def _shapes(arm: ArmArticulation) -> list[tuple[str, Shape]]:
    """Return all that is to be seen of an arm, with the links it belongs to."""
    return [(link, shape) for link, shapes in arm.description.robot.visuals.items() for shape in shapes]
