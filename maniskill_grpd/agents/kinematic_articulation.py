"""A batched articulation whose grippers a deformable solver moves; it stands in for a PhysX articulation."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import torch
from mani_skill.utils import common

if TYPE_CHECKING:
    from mani_skill.envs.scene import ManiSkillScene


class KinematicArticulation(ABC):
    """An articulation with n grippers, which are where the solver has them.

    It implements `Effectors`, and offers the part of `mani_skill.utils.structs.Articulation` that
    agents, controllers and the state of a scene use. Positions and targets of the grippers are views
    of the tensors it is given (those of the deformable solver), so there is one truth and nothing to
    keep in step.

    Attributes:
        positions: Where the grippers are, (B, n, 3) [m].
        velocities: Their displacements in the last control step over its duration, (B, n, 3) [m/s].
        drive_targets: Where they are to be after the next step, (B, 3 * n) [m].
        max_dof: Number of joints.

    Limitations: no contact forces.
    """

    merged = False

    def __init__(
        self,
        scene: ManiSkillScene,
        name: str,
        *,
        positions: torch.Tensor,
        targets: torch.Tensor,
        grip_commands: torch.Tensor,
        joints: Sequence[str],
        links: Sequence[str],
    ) -> None:
        """Wrap gripper tensors, which may be those of some of the grippers of a solver.

        Args:
            scene: Scene whose `_reset_mask` says which worlds the setters write.
            name: Name in the state dictionary.
            positions: Gripper positions, (B, n, 3) [m]; read and written in place.
            targets: Gripper targets, (B, n, 3) [m]; written in place.
            grip_commands: Whether grippers are to be closed, (B, n) bool; written in place.
            joints: Names of the joints.
            links: Names of the links.
        """
        self.scene = scene
        self.name = name
        self.num_grippers = positions.shape[1]
        self.positions = positions
        self.velocities = torch.zeros_like(positions)
        self.drive_targets = targets.view(len(targets), -1)
        self._grip_commands = grip_commands
        self._start_of_motion = positions.clone()
        self._floor: tuple[torch.Tensor, float] | None = None

        self.max_dof = len(joints)
        self.joints = [KinematicJoint(joint, index) for index, joint in enumerate(joints)]
        self.active_joints = self.joints
        self.joints_map = self.active_joints_map = {joint.name: joint for joint in self.joints}
        self.links = [KinematicLink(link) for link in links]
        self.links_map = {link.name: link for link in self.links}

    # ------------------------------------------------------------------ motion

    def start_motion(self) -> None:
        """Remember where the grippers are; call before a control step."""
        self._start_of_motion.copy_(self.positions)

    def finish_motion(self, duration: float) -> None:
        """Derive `velocities` from the displacement since `start_motion`, `duration` [s] ago."""
        torch.sub(self.positions, self._start_of_motion, out=self.velocities)
        self.velocities.div_(duration)

    def move(self, rotation: torch.Tensor, translation: torch.Tensor) -> None:
        """Turn the velocities with their worlds; the solver moves the grippers themselves."""
        self.velocities.copy_(self.velocities @ rotation.mT)

    def place(self, worlds: torch.Tensor) -> None:
        """Bring the grippers of some worlds (b,) to rest where they are."""
        self.drive_targets[worlds] = self.positions[worlds].flatten(1)
        self.velocities[worlds] = 0.0

    def command_grip(self, closed: torch.Tensor) -> None:
        """Say which grippers are to be closed from the next step on, (B, n) bool."""
        self._grip_commands.copy_(closed)

    def set_floor(self, plane: torch.Tensor, clearance: float) -> None:
        """Let targets keep `clearance` [m] from the surface n . x = c of `plane` (B, 4) = (n, c).

        The tensor is kept, not copied: when the plane moves, the limit moves with it.
        """
        self._floor = (plane, clearance)

    def keep_above_floor(self, targets: torch.Tensor) -> torch.Tensor:
        """Return targets (B, n, 3) [m], moved along the plane's normal where they are too low."""
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

    @abstractmethod
    def get_qpos(self) -> torch.Tensor:
        """Return a copy of the joint positions, (B, max_dof)."""

    @abstractmethod
    def get_qvel(self) -> torch.Tensor:
        """Return a copy of the joint velocities, (B, max_dof)."""

    @abstractmethod
    def get_qlimits(self) -> torch.Tensor:
        """Return joint limits (B, max_dof, 2)."""

    @abstractmethod
    def set_qpos(self, qpos: torch.Tensor) -> None:
        """Set the joint positions of the worlds being reset; rows (b, max_dof) or one row for all."""

    @abstractmethod
    def set_qvel(self, qvel: torch.Tensor) -> None:
        """Set the joint velocities of the worlds being reset; rows (b, max_dof) or one for all."""

    @abstractmethod
    def get_state(self) -> torch.Tensor:
        """Return root pose and velocity, then what is the articulation's own, (B, D)."""

    @abstractmethod
    def set_state(self, state: torch.Tensor, env_idx: torch.Tensor | None = None) -> None:
        """Restore rows of `get_state` for the worlds `env_idx`, or for those being reset."""

    def get_joints(self) -> list[KinematicJoint]:
        """Return all joints."""
        return self.joints

    def get_active_joints(self) -> list[KinematicJoint]:
        """Return all joints: each can be driven."""
        return self.active_joints

    def get_links(self) -> list[KinematicLink]:
        """Return the links."""
        return self.links

    def set_qf(self, qf: torch.Tensor) -> None:  # noqa: B027 (there is nothing to do)
        """Ignore joint forces: the joints are kinematic."""

    def set_joint_drive_targets(
        self, targets: torch.Tensor, joints: list[KinematicJoint] | None = None, joint_indices: torch.Tensor | None = None
    ) -> None:
        """Set where grippers (by default all) will be after the next step, (B, 3 * n) [m]."""
        if joint_indices is None:
            self.drive_targets.copy_(targets)
        else:
            self.drive_targets[:, joint_indices.long()] = targets

    def _state_rows(self, state: Any, env_idx: torch.Tensor | None) -> tuple[torch.Tensor, torch.Tensor]:
        """Return rows of a state as a tensor, and which worlds they are for."""
        worlds = self.scene._reset_mask if env_idx is None else env_idx
        return common.to_tensor(state, device=self.device), worlds

    def _write(self, buffer: torch.Tensor, values: torch.Tensor) -> None:
        buffer[self.scene._reset_mask] = common.to_tensor(values, device=self.device)


class KinematicJoint:
    """A joint that reaches its target; drive gains mean nothing to it."""

    def __init__(self, name: str, index: int) -> None:
        self.name = name
        self.active_index = torch.tensor([index], dtype=torch.int32)

    def set_drive_properties(self, *args: object, **kwargs: object) -> None:
        """Ignore stiffness, damping and force limit."""

    def set_friction(self, friction: float) -> None:
        """Ignore joint friction."""


class KinematicLink:
    """A link; exists because ManiSkill turns off the gravity of links."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.disable_gravity = True
