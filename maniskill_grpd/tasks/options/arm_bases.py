"""Where arms stand."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sapien

from maniskill_grpd.tasks.options.gripper_teams import Team, is_arm_team, members

BASE_DISTANCE = 0.615
"""Distance of the bases from the middle of the table [m], that of the Panda in ManiSkill's table scenes."""
UNIT_TOLERANCE = 1e-3
"""By how much the length of a quaternion may differ from 1."""


def round_the_table(num_arms: int) -> np.ndarray:
    """Return where arms stand round a table, (A, 4, 4): a single one at -x, several at equal angles from -y on.

    A single one looks along x, as in ManiSkill's table scenes, the others look at the middle; two as in `TwoRobotPickCube-v1`,
    but nearer: there they are to need each other.
    """
    if num_arms == 1:
        return sapien.Pose([-BASE_DISTANCE, 0.0, 0.0]).to_transformation_matrix()[None]
    angles = -np.pi / 2 + 2.0 * np.pi * np.arange(num_arms) / num_arms
    return np.stack(
        [standing_at([BASE_DISTANCE * np.cos(angle), BASE_DISTANCE * np.sin(angle), 0.0], angle + np.pi) for angle in angles]
    )


def beside_the_way(num_arms: int) -> np.ndarray:
    """Return where three or four arms stand beside a way from the origin along x, (A, 4, 4); the third of three hangs above."""
    sides = [(x, y) for y in (-0.6, 0.6) for x in ((0.3,) if num_arms == 3 else (0.1, 0.6))]
    bases = [standing_at([x, y, -0.3], -np.pi / 2 if y > 0.0 else np.pi / 2) for x, y in sides]
    if num_arms == 3:
        bases.append(sapien.Pose([0.3, 0.0, 0.9], [0.0, 1.0, 0.0, 0.0]).to_transformation_matrix())
    return np.stack(bases)


def standing_at(position: Sequence[float], angle: float) -> np.ndarray:
    """Return the frame (4, 4) of an upright base at a position (3,) [m] that looks along x turned by an angle about z [rad]."""
    return sapien.Pose(position, [np.cos(0.5 * angle), 0.0, 0.0, np.sin(0.5 * angle)]).to_transformation_matrix()


def arm_bases(team: Team, robot_poses: Any | None, default: Callable[[int], np.ndarray] = round_the_table) -> np.ndarray | None:
    """Return the frames of the bases of arms, (A, 4, 4), or None for floating grippers.

    Args:
        team: The agents.
        robot_poses: One `sapien.Pose` for each arm, or (A, 7) numbers: position [m] and quaternion (w, x, y, z); or None.
        default: Returns where so many arms stand where nothing is said.

    Raises:
        ValueError: If there are not as many poses as arms, or one is none.
    """
    num_arms = len(members(team)) if is_arm_team(team) else 0
    if robot_poses is None:
        return default(num_arms) if num_arms else None
    if not num_arms:
        raise ValueError(f"robot_poses are where arms stand; {team!r} has no bases")
    poses = [robot_poses] if isinstance(robot_poses, sapien.Pose) else list(robot_poses)
    if len(poses) != num_arms:
        raise ValueError(f"robot_poses must be {num_arms} poses, one for each arm, got {len(poses)}")
    return np.stack([_as_matrix(pose) for pose in poses])


def _as_matrix(pose: sapien.Pose | Sequence[float]) -> np.ndarray:
    if not isinstance(pose, sapien.Pose):
        numbers = np.asarray(pose, dtype=np.float64).ravel()
        if numbers.shape != (7,) or not np.isfinite(numbers).all() or abs(np.linalg.norm(numbers[3:]) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(
                f"a pose of robot_poses must be a sapien.Pose, or a position and a unit quaternion (w, x, y, z), got {pose!r}"
            )
        pose = sapien.Pose(numbers[:3], numbers[3:])
    return pose.to_transformation_matrix()
