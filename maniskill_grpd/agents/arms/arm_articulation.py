"""One arm of every world as a batched articulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from mani_skill.utils.geometry.rotation_conversions import matrix_to_quaternion, quaternion_multiply

from maniskill_grpd.agents.arms.arm_bodies import ArmBodies
from maniskill_grpd.agents.kinematic_articulation import KinematicArticulation

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene

ROOT_SIZE, POINT_SIZE = 13, 3
"""Numbers of a state: pose and velocity of the root; velocity of the TCP."""


class ArmArticulation(KinematicArticulation):
    """An arm with its fingers; its one gripper is its TCP.

    Joints of the arm come first, then those of the fingers, which open and close by themselves as the grip is. All of them are
    kinematic (`ArmBodies`).
    """

    def __init__(self, scene: ManiSkillScene, name: str, bodies: ArmBodies, arm: int) -> None:
        """Take an arm.

        Args:
            scene: A scene that holds a solver and the commands of its grips.
            name: Name in the state dictionary.
            bodies: The arms of all worlds.
            arm: Which of them it is, and so which gripper.
        """
        self.bodies, self.arm = bodies, arm
        self.description = bodies.descriptions[arm]
        self.num_arm_joints = len(self.description.arm_joints)
        solver, mine = scene.solver, slice(arm, arm + 1)
        self._closed = solver.closed[:, mine]
        super().__init__(
            scene,
            name,
            positions=solver.gripper_positions[:, mine],
            targets=solver.gripper_targets[:, mine],
            grip_commands=scene.grip_commands[:, mine],
            joints=[joint.name for joint in (*self.description.arm_joints, *self.description.fingers)],
            links=list(self.description.robot.shapes),
        )
        limits = torch.tensor([[joint.lower, joint.upper, joint.speed] for joint in self.description.fingers]).view(-1, 3)
        self._finger_limits = limits.to(device=self.device, dtype=torch.float32)
        self.fingers = self._finger_limits[:, 1].repeat(scene.num_envs, 1)
        self.finger_velocities = torch.zeros_like(self.fingers)

    @property
    def qpos(self) -> torch.Tensor:
        """Positions of the joints of the arm, a view (B, number of them) [rad]."""
        return self.bodies.qpos[:, self.arm, : self.num_arm_joints]

    @property
    def qvel(self) -> torch.Tensor:
        """Their velocities, a view (B, number of them) [rad/s]."""
        return self.bodies.qvel[:, self.arm, : self.num_arm_joints]

    @property
    def tcp_pose(self) -> torch.Tensor:
        """Position [m] and quaternion (w, x, y, z) of the tool in the world, (B, 7)."""
        rotation = self.bodies.rotations[:, self.arm]
        return torch.cat([self.positions[:, 0], rotation[:, 3:], rotation[:, :3]], dim=1)

    # ------------------------------------------------------------------ commands

    def command_point(self, displacements: torch.Tensor, turns: torch.Tensor | None = None) -> None:
        """Move the target of the TCP by (B, 3) [m], and turn the hand by axis-angle vectors (B, 3) [rad] if it is held."""
        targets = self.drive_targets.unflatten(1, (-1, 3)) + displacements[:, None]
        self.drive_targets.copy_(self.keep_above_floor(targets).flatten(1))
        self.bodies.postures[:, self.arm] = self.bodies.rest[self.arm]
        if turns is not None:
            rotations = self.bodies.rotations[:, self.arm]
            rotations.copy_(_turned(turns, rotations))

    def command_joints(self, targets: torch.Tensor) -> None:
        """Tell the joints of the arm where to go, (B, number of them) [rad]: as far as limits, speeds and accelerations allow."""
        bodies, arm, num = self.bodies, self.arm, self.num_arm_joints
        low, high = (bound[:, arm, :num] for bound in bodies.next_range())
        for goals in (bodies.seeds, bodies.postures):
            goals[:, arm, :num] = targets.clamp(low, high)
        tools = bodies.forward(bodies.seeds)[:, arm]
        self.drive_targets.copy_(self.keep_above_floor(tools[:, None, :3]).flatten(1))
        bodies.rotations[:, arm] = tools[:, 3:]

    # ------------------------------------------------------------------ motion

    def finish_motion(self, duration: float) -> None:
        """Derive the velocity of the TCP, and move the fingers as far as their speeds allow."""
        super().finish_motion(duration)
        lower, upper, speed = self._finger_limits.unbind(1)
        goal = torch.where(self._closed, lower, upper)
        change = torch.minimum(torch.maximum(goal - self.fingers, -speed * duration), speed * duration)
        self.fingers.add_(change)
        self.finger_velocities.copy_(change / duration)

    def move(self, rotation: torch.Tensor, translation: torch.Tensor) -> None:
        """Move base and hand with their worlds."""
        super().move(rotation, translation)
        base = self.bodies.bases[:, self.arm]
        base[:, :3] = (rotation @ base[:, :3, None])[..., 0] + translation
        turn = matrix_to_quaternion(rotation)
        base[:, 3:] = _xyzw(quaternion_multiply(turn, _wxyz(base[:, 3:])))
        hand = self.bodies.rotations[:, self.arm]
        hand.copy_(_xyzw(quaternion_multiply(turn, _wxyz(hand))))

    def place(self, worlds: torch.Tensor) -> None:
        """Bring the arm to rest where `ArmBodies.solve` has put it, with its fingers as the grip is."""
        super().place(worlds)
        lower, upper, _ = self._finger_limits.unbind(1)
        self.fingers[worlds] = torch.where(self._closed[worlds], lower, upper)
        self.finger_velocities[worlds] = 0.0

    # ------------------------------------------------------------------ state

    def get_qpos(self) -> torch.Tensor:
        """Return a copy of all joint positions, (B, max_dof) [rad], fingers [m]."""
        return torch.cat([self.qpos, self.fingers], dim=1)

    def get_qvel(self) -> torch.Tensor:
        """Return a copy of all joint velocities, (B, max_dof) [rad/s], fingers [m/s]."""
        return torch.cat([self.qvel, self.finger_velocities], dim=1)

    def get_qlimits(self) -> torch.Tensor:
        """Return joint limits (B, max_dof, 2)."""
        bodies, num = self.bodies, self.num_arm_joints
        own = torch.stack([bodies.lower[self.arm, :num], bodies.upper[self.arm, :num]], dim=1)
        return torch.cat([own, self._finger_limits[:, :2]]).expand(len(self.qpos), -1, -1)

    def set_qpos(self, qpos: torch.Tensor) -> None:
        """Refuse: the gripper would be elsewhere than the solver has it.

        Raises:
            NotImplementedError: Always.
        """
        raise NotImplementedError("arms hold an object: reset the environment, or restore a whole state of it")

    def set_qvel(self, qvel: torch.Tensor) -> None:
        """Do nothing: what is placed by a reset is at rest."""

    def get_state(self) -> torch.Tensor:
        """Return root pose (position, quaternion w, x, y, z) and velocity (0), all qpos and qvel, velocity of the TCP, (B, D)."""
        base = self.bodies.bases[:, self.arm]
        root = torch.cat([base[:, :3], _wxyz(base[:, 3:]), torch.zeros(len(base), 6, device=self.device)], dim=1)
        return torch.cat([root, self.get_qpos(), self.get_qvel(), self.velocities[:, 0]], dim=1)

    def set_state(self, state: torch.Tensor, env_idx: torch.Tensor | None = None) -> None:
        """See `KinematicArticulation.set_state`."""
        rows, worlds = self._state_rows(state, env_idx)
        arm, num = self.arm, self.num_arm_joints
        root, qpos, qvel, velocities = rows.split([ROOT_SIZE, self.max_dof, self.max_dof, POINT_SIZE], dim=1)
        self.bodies.bases[worlds, arm] = torch.cat([root[:, :3], _xyzw(root[:, 3:7])], dim=1)
        padding = self.bodies.rest[arm, num:].expand(len(rows), -1)
        self.bodies.set_qpos(worlds, slice(arm, arm + 1), torch.cat([qpos[:, :num], padding], dim=1)[:, None])
        self.bodies.qvel[worlds, arm, :num] = qvel[:, :num]
        self.fingers[worlds], self.finger_velocities[worlds] = qpos[:, num:], qvel[:, num:]
        self.velocities[worlds, 0] = velocities


def _turned(turns: torch.Tensor, rotations: torch.Tensor) -> torch.Tensor:
    """Return rotations (B, 4), quaternions (x, y, z, w), turned in the world by axis-angle vectors (B, 3) [rad]."""
    half = 0.5 * torch.linalg.vector_norm(turns, dim=1, keepdim=True)
    # sin(|a| / 2) a / |a| without the division by zero
    quaternion = torch.cat([half.cos(), 0.5 * torch.sinc(half / torch.pi) * turns], dim=1)
    return _xyzw(quaternion_multiply(quaternion, _wxyz(rotations)))


def _wxyz(quaternions: torch.Tensor) -> torch.Tensor:
    return quaternions.roll(1, dims=1)


def _xyzw(quaternions: torch.Tensor) -> torch.Tensor:
    return quaternions.roll(-1, dims=1)
