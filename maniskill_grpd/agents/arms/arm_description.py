"""Arms as descriptions: a URDF file and the names of what matters in it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from mani_skill import PACKAGE_ASSET_DIR
from mani_skill.agents.robots.panda.panda import Panda
from mani_skill.agents.robots.xarm.xarm7_ability import XArm7Ability

from maniskill_grpd.agents.arms.kinematics import NUM_JOINTS
from maniskill_grpd.agents.arms.urdf import Joint, Robot, read_urdf


@dataclass(frozen=True)
class ArmDescription:
    """An arm with a fixed base and a tool that holds an object at one point.

    A new arm is a new description, handed to `register_arm`. Chain, joint limits, largest speeds and meshes are those of the
    URDF file.
    """

    uid: str
    """Name in `robot_uids`."""
    urdf: Path
    tcp_link: str
    """Link whose origin holds the object: the tool centre point, TCP. Its z axis points out of the hand."""
    rest_qpos: tuple[float, ...]
    """Where the joints of the chain are drawn to as far as the task of the arm leaves them free [rad], from the base."""
    finger_joints: tuple[str, ...] = ()
    """Joints of fingers, which close to their lower and open to their upper limits."""
    accelerations: tuple[float, ...] | None = None
    """Largest acceleration of each joint of the chain [rad/s^2], which URDF files do not have; None for any."""

    def __post_init__(self) -> None:
        """Refuse a description that its file does not fit.

        Raises:
            ValueError: Naming what the file lacks.
        """
        joints = self.arm_joints
        if not joints:
            raise ValueError(f"no joint of {self.urdf} moves {self.tcp_link!r}")
        if len(joints) > NUM_JOINTS:
            raise ValueError(f"arms have at most {NUM_JOINTS} joints, {self.uid!r} has {len(joints)}")
        if len(self.rest_qpos) != len(joints):
            raise ValueError(f"rest_qpos of {self.uid!r} must have {len(joints)} numbers, got {len(self.rest_qpos)}")
        for joint, position in zip(joints, self.rest_qpos, strict=True):
            if not joint.lower <= position <= joint.upper:
                raise ValueError(
                    f"rest_qpos of {self.uid!r} is out of the limits [{joint.lower}, {joint.upper}] of {joint.name}: {position}"
                )
            if not joint.speed > 0.0:
                raise ValueError(f"joint {joint.name} of {self.urdf} has no largest velocity; a kinematic arm needs one")
        if self.accelerations is not None:
            self._check_accelerations(self.accelerations)
        if unknown := [name for name in self.finger_joints if name not in self.robot.joints]:
            raise ValueError(f"{self.urdf} has no joints {unknown}; it has {', '.join(self.robot.joints)}")

    def _check_accelerations(self, accelerations: tuple[float, ...]) -> None:
        count = len(self.arm_joints)
        if len(accelerations) != count or not all(value > 0.0 for value in accelerations):
            raise ValueError(
                f"accelerations of {self.uid!r} must be {count} numbers > 0, one for each joint, got {accelerations}"
            )

    @cached_property
    def robot(self) -> Robot:
        """What the URDF file says."""
        return read_urdf(self.urdf)

    @cached_property
    def arm_joints(self) -> tuple[Joint, ...]:
        """The joints that move the TCP, from the base."""
        return tuple(joint for joint in self.robot.chain(self.tcp_link) if joint.motion is not None)

    @cached_property
    def fingers(self) -> tuple[Joint, ...]:
        """The joints of the fingers."""
        return tuple(self.robot.joints[name] for name in self.finger_joints)

    @cached_property
    def offsets(self) -> np.ndarray:
        """Frame of each moving joint at rest in that of the one before it, and the TCP in the last, (J + 1, 4, 4)."""
        offsets, offset = [], np.eye(4)
        for joint in self.robot.chain(self.tcp_link):
            offset = offset @ joint.origin
            if joint.motion is not None:
                offsets.append(offset)
                offset = np.eye(4)
        return np.stack([*offsets, offset])


ARMS: dict[str, ArmDescription] = {}
"""All arms, by the name that `robot_uids` gives them."""


def register_arm(description: ArmDescription) -> ArmDescription:
    """Let `robot_uids` name an arm.

    Raises:
        ValueError: If another one has its name.
    """
    if ARMS.get(description.uid, description) != description:
        raise ValueError(f"there is an arm {description.uid!r} already")
    ARMS[description.uid] = description
    return description


_ROBOTS = Path(PACKAGE_ASSET_DIR) / "robots"

PANDA = register_arm(
    ArmDescription(
        uid="panda",
        urdf=Path(Panda.urdf_path),
        tcp_link=Panda.ee_link_name,
        rest_qpos=tuple(float(q) for q in Panda.keyframes["rest"].qpos[: len(Panda.arm_joint_names)]),
        finger_joints=tuple(Panda.gripper_joint_names),
        accelerations=(15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0),  # Franka's data sheet
    )
)
"""Franka's arm with seven joints and two fingers, as ManiSkill describes it."""
XARM7 = register_arm(
    ArmDescription(
        uid="xarm7",
        urdf=_ROBOTS / "xarm7/xarm7.urdf",
        tcp_link="link_eef",
        rest_qpos=tuple(float(q) for q in XArm7Ability.keyframes["rest"].qpos[:7]),
        accelerations=(20.0,) * 7,  # UFACTORY's data sheet: 1145 degrees/s^2
    )
)
"""UFACTORY's arm with seven joints and no hand: its flange holds the object."""
