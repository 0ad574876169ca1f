"""Where the links of an arm are, in all worlds at once."""

from __future__ import annotations

import torch
from mani_skill.utils.geometry.rotation_conversions import axis_angle_to_matrix, quaternion_to_matrix

from maniskill_grpd.agents.arms.arm_articulation import ArmArticulation
from maniskill_grpd.agents.arms.urdf import PRISMATIC, REVOLUTE, Joint


def link_frames(arm: ArmArticulation) -> dict[str, torch.Tensor]:
    """Return the frames of all links in the world, (B, 4, 4) each, by their names."""
    base = arm.bodies.bases[:, arm.arm]
    root = _matrices(quaternion_to_matrix(base[:, [6, 3, 4, 5]]), base[:, :3])
    positions = dict(zip([joint.name for joint in arm.joints], arm.get_qpos().unbind(1), strict=True))
    robot = arm.description.robot
    found, waiting = {robot.root: root}, list(robot.joints.values())
    while waiting:
        for joint in [joint for joint in waiting if joint.parent in found]:
            origin = torch.as_tensor(joint.origin, dtype=root.dtype, device=root.device)
            position = positions.get(joint.name, torch.zeros_like(root[:, 0, 0]))
            found[joint.child] = found[joint.parent] @ origin @ _displacements(joint, position)
        waiting = [joint for joint in waiting if joint.child not in found]
    return found


def _displacements(joint: Joint, positions: torch.Tensor) -> torch.Tensor:
    """Return what a joint at positions (B,) does in its frame, (B, 4, 4)."""
    along = positions[:, None] * torch.as_tensor(joint.axis, dtype=positions.dtype, device=positions.device)
    turn = along if joint.motion == REVOLUTE else torch.zeros_like(along)
    shift = along if joint.motion == PRISMATIC else torch.zeros_like(along)
    return _matrices(axis_angle_to_matrix(turn), shift)


def _matrices(rotations: torch.Tensor, positions: torch.Tensor) -> torch.Tensor:
    """Return homogeneous matrices (B, 4, 4) of rotations (B, 3, 3) and positions (B, 3)."""
    matrices = torch.eye(4, dtype=positions.dtype, device=positions.device).repeat(len(positions), 1, 1)
    matrices[:, :3, :3], matrices[:, :3, 3] = rotations, positions
    return matrices
