"""A batched articulation of floating grippers that stands in for a PhysX articulation."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from mani_skill.utils import common

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene

AXES = "xyz"


class KinematicArticulation:
    """Grippers as one articulation of 3 * A prismatic joints that reach their drive targets.

    It implements `Effectors`, and offers the part of `mani_skill.utils.structs.Articulation` that
    agents, controllers and the state of a scene use. Positions and targets are views of the tensors it is given (those of the
    deformable solver), so there is one truth and nothing to keep in step.

    Attributes:
        qpos: Gripper positions in the world frame, (B, 3 * A) [m].
        qvel: Displacement of the last control step over its duration, (B, 3 * A) [m/s].
        drive_targets: Where the grippers will be after the next step, (B, 3 * A) [m].

    Limitations: no links but a root without pose, no orientation, no contact forces.
    """

    merged = False

    def __init__(
        self, scene: ManiSkillScene, name: str, *, positions: torch.Tensor, targets: torch.Tensor, grip_commands: torch.Tensor
    ) -> None:
        """Wrap gripper tensors, which may be those of some of the grippers of a solver.

        Args:
            scene: Scene whose `_reset_mask` says which worlds the setters write.
            name: Name in the state dictionary.
            positions: Gripper positions, (B, A, 3) [m]; read and written in place.
            targets: Gripper targets, (B, A, 3) [m]; written in place.
            grip_commands: Whether grippers are to be closed, (B, A) bool; written in place.
        """
        self.scene = scene
        self.name = name
        self.num_grippers = positions.shape[1]
        self.qpos = positions.view(len(positions), -1)
        self.qvel = torch.zeros_like(self.qpos)
        self.drive_targets = targets.view(len(targets), -1)
        self._grip_commands = grip_commands
        self._start_of_motion = self.qpos.clone()
        self._floor: tuple[torch.Tensor, float] | None = None

        self.max_dof = self.qpos.shape[1]
        self.joints = [
            KinematicJoint(f"gripper_{index}_{axis}", 3 * index + offset)
            for index in range(self.num_grippers)
            for offset, axis in enumerate(AXES)
        ]
        self.active_joints = self.joints
        self.joints_map = self.active_joints_map = {joint.name: joint for joint in self.joints}
        self.links = [KinematicLink("root")]
        self.links_map = {link.name: link for link in self.links}

    # ------------------------------------------------------------------ motion

    def start_motion(self) -> None:
        """Remember where the grippers are; call before a control step."""
        self._start_of_motion.copy_(self.qpos)

    def finish_motion(self, duration: float) -> None:
        """Derive `qvel` from the displacement since `start_motion`, `duration` [s] ago."""
        torch.sub(self.qpos, self._start_of_motion, out=self.qvel)
        self.qvel.div_(duration)

    @property
    def velocities(self) -> torch.Tensor:
        """`qvel` by gripper, (B, A, 3) [m/s]."""
        return self.qvel.unflatten(1, (-1, 3))

    def move(self, rotation: torch.Tensor, translation: torch.Tensor) -> None:
        """Turn the velocities with their worlds; the solver moves the grippers themselves."""
        self.qvel.copy_((self.velocities @ rotation.mT).flatten(1))

    def place(self, worlds: torch.Tensor) -> None:
        """Bring the grippers of some worlds (b,) to rest where they are."""
        self.drive_targets[worlds] = self.qpos[worlds]
        self.qvel[worlds] = 0.0

    def command_grip(self, closed: torch.Tensor) -> None:
        """Say which grippers are to be closed from the next step on, (B, A) bool."""
        self._grip_commands.copy_(closed)

    def set_floor(self, plane: torch.Tensor, clearance: float) -> None:
        """Let targets keep `clearance` [m] from the surface n . x = c of `plane` (B, 4) = (n, c).

        The tensor is kept, not copied: when the plane moves, the limit moves with it.
        """
        self._floor = (plane, clearance)

    def keep_above_floor(self, targets: torch.Tensor) -> torch.Tensor:
        """Return targets (B, A, 3) [m], moved along the plane's normal where they are too low."""
        if self._floor is None:
            return targets
        plane, clearance = self._floor
        normal = plane[:, None, :3]
        height = (targets * normal).sum(-1, keepdim=True) - plane[:, None, 3:]
        return targets + normal * (clearance - height).clamp_min_(0.0)

    # ------------------------------------------------------------------ what controllers use

    @property
    def device(self) -> torch.device:
        """Device of all tensors."""
        return self.scene.device

    @property
    def px(self) -> Any:
        """The PhysX system; controllers read the length of a time step from it."""
        return self.scene.px

    def get_qpos(self) -> torch.Tensor:
        """Return a copy of `qpos`."""
        return self.qpos.clone()

    def get_qvel(self) -> torch.Tensor:
        """Return a copy of `qvel`."""
        return self.qvel.clone()

    def get_qlimits(self) -> torch.Tensor:
        """Return joint limits (B, 3 * A, 2) [m]: floating grippers have none."""
        limits = torch.tensor([-torch.inf, torch.inf], device=self.device)
        return limits.expand(len(self.qpos), self.max_dof, 2)

    def get_joints(self) -> list[KinematicJoint]:
        """Return all joints."""
        return self.joints

    def get_active_joints(self) -> list[KinematicJoint]:
        """Return all joints: each can be driven."""
        return self.active_joints

    def get_links(self) -> list[KinematicLink]:
        """Return the root, the only link."""
        return self.links

    def set_qpos(self, qpos: torch.Tensor) -> None:
        """Move the grippers of the worlds being reset; rows (b, 3 * A) or one row for all [m]."""
        self._write(self.qpos, qpos)

    def set_qvel(self, qvel: torch.Tensor) -> None:
        """Set the velocities of the worlds being reset; rows (b, 3 * A) or one for all [m/s]."""
        self._write(self.qvel, qvel)

    def set_qf(self, qf: torch.Tensor) -> None:
        """Ignore joint forces: the joints are kinematic."""

    def set_joint_drive_targets(
        self, targets: torch.Tensor, joints: list[KinematicJoint] | None = None, joint_indices: torch.Tensor | None = None
    ) -> None:
        """Set where joints (all by default) will be after the next step, (B, joints) [m]."""
        if joint_indices is None:
            self.drive_targets.copy_(targets)
        else:
            self.drive_targets[:, joint_indices.long()] = targets

    def get_state(self) -> torch.Tensor:
        """Return root pose and velocity (constant), qpos and qvel, (B, 13 + 6 * A)."""
        root = torch.zeros(len(self.qpos), 13, device=self.device)
        root[:, 3] = 1.0  # quaternion (w, x, y, z) of no rotation
        return torch.cat([root, self.qpos, self.qvel], dim=1)

    def set_state(self, state: torch.Tensor, env_idx: torch.Tensor | None = None) -> None:
        """Restore rows of `get_state` for the worlds `env_idx`, or for those being reset."""
        state = common.to_tensor(state, device=self.device)
        worlds = self.scene._reset_mask if env_idx is None else env_idx
        self.qpos[worlds], self.qvel[worlds] = state[:, 13:].split(self.max_dof, dim=1)

    def _write(self, buffer: torch.Tensor, values: torch.Tensor) -> None:
        buffer[self.scene._reset_mask] = common.to_tensor(values, device=self.device)


class KinematicJoint:
    """A prismatic joint that reaches its target; drive gains mean nothing to it."""

    def __init__(self, name: str, index: int) -> None:
        self.name = name
        self.active_index = torch.tensor([index], dtype=torch.int32)

    def set_drive_properties(self, *args: object, **kwargs: object) -> None:
        """Ignore stiffness, damping and force limit."""

    def set_friction(self, friction: float) -> None:
        """Ignore joint friction."""


class KinematicLink:
    """The root of the grippers; exists because ManiSkill turns off the gravity of links."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.disable_gravity = True
