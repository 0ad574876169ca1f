"""Where arms stand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import sapien

from maniskill_grpd.tasks.options.gripper_teams import Team, is_arm_team, members

BASE_DISTANCE = 0.615
"""Distance of the bases from the middle of the table [m], that of the Panda in ManiSkill's table scenes."""
UNIT_TOLERANCE = 1e-3
"""By how much the length of a quaternion may differ from 1."""


def arm_bases(team: Team, robot_poses: Any | None) -> np.ndarray | None:
    """Return the frames of the bases of arms, (A, 4, 4), or None for floating grippers.

    By default a single arm stands at -x and looks along x, as in ManiSkill's table scenes, and several stand round the middle,
    which they face: two at -y and y, as in `TwoRobotPickCube-v1` (but nearer: there they are to need each other), more at equal
    angles from -y on.

    Args:
        team: The agents.
        robot_poses: One `sapien.Pose` for each arm, or (A, 7) numbers: position [m] and quaternion (w, x, y, z); or None.

    Raises:
        ValueError: If there are not as many poses as arms, or one is none.
    """
    num_arms = len(members(team)) if is_arm_team(team) else 0
    if robot_poses is None:
        return _default_bases(num_arms) if num_arms else None
    if not num_arms:
        raise ValueError(f"robot_poses are where arms stand; {team!r} has no bases")
    poses = [robot_poses] if isinstance(robot_poses, sapien.Pose) else list(robot_poses)
    if len(poses) != num_arms:
        raise ValueError(f"robot_poses must be {num_arms} poses, one for each arm, got {len(poses)}")
    return np.stack([_as_matrix(pose) for pose in poses])


def _default_bases(num_arms: int) -> np.ndarray:
    if num_arms == 1:
        return sapien.Pose([-BASE_DISTANCE, 0.0, 0.0]).to_transformation_matrix()[None]
    angles = -np.pi / 2 + 2.0 * np.pi * np.arange(num_arms) / num_arms
    return np.stack([_facing_middle(angle) for angle in angles])


def _facing_middle(angle: float) -> np.ndarray:
    half = 0.5 * (angle + np.pi)
    position = [BASE_DISTANCE * np.cos(angle), BASE_DISTANCE * np.sin(angle), 0.0]
    return sapien.Pose(position, [np.cos(half), 0.0, 0.0, np.sin(half)]).to_transformation_matrix()


def _as_matrix(pose: sapien.Pose | Sequence[float]) -> np.ndarray:
    if not isinstance(pose, sapien.Pose):
        numbers = np.asarray(pose, dtype=np.float64).ravel()
        if numbers.shape != (7,) or not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[3:]) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(
                f"a pose of robot_poses must be a sapien.Pose, or a position and a unit quaternion (w, x, y, z), got {pose!r}"
            )
        pose = sapien.Pose(numbers[:3], numbers[3:])
    return pose.to_transformation_matrix()
