"""The arms of all worlds: their state, and the kernels that move them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from maniskill_grpd.agents.arms.arm_description import ArmDescription
from maniskill_grpd.agents.arms.capsules import arm_links, column_capsule, link_capsules
from maniskill_grpd.agents.arms.kinematics import FIXED, NUM_JOINTS, PRISMATIC, REVOLUTE, Arms
from maniskill_grpd.agents.arms.motion import follow_kernel
from maniskill_grpd.agents.arms.placing import forward, place
from maniskill_grpd.agents.arms.urdf import REVOLUTE as TURNS
from maniskill_grpd.physics import Solver
from maniskill_grpd.physics.launches import Launches, choose_num_threads, quiet_warp
from maniskill_grpd.physics.links import LinkMotions

UNLIMITED = 1.0e6
"""Acceleration of joints for which none is given [rad/s^2]."""
REACHED = 1.0e-3
"""Distance [m] from a point at which an arm that is put there has come to it."""


class ArmBodies:
    """A arms in each of B worlds, one for each gripper of a solver, which is where the TCP of its arm is.

    J is `NUM_JOINTS`; arms with fewer have fixed joints behind theirs.

    Arms are kinematic: within a control step a joint goes where it is told, no farther than its limits and its largest speed
    allow. What is lost thereby the gripper does not do. World i of a batch does the same arithmetic whatever B is.

    Attributes:
        descriptions: One for each arm.
        bases: Frames of the bases in the world, (B, A, 7): position [m], quaternion (x, y, z, w).
        qpos: Joint positions, (B, A, J) [rad].
        qvel: Their change in the last control step over its duration, (B, A, J) [rad/s].
        seeds: Where the joints are told to go first, (B, A, J); from there the TCPs are brought to the targets of the grippers.
        postures: What joints are drawn to as far as TCPs leave them free, (B, A, J).
        rotations: Quaternions (x, y, z, w) of the hands, (B, A, 4): those wanted, and after a step those there are.
        errors: How far each TCP missed in the last step where object and obstacles would have let it go, (B, A) [m].
        refused: Whether an arm stood still in the last step, because its links would have come into the table or into another
            arm's base, or because object, obstacles and arms of its world found no agreement, (B, A) bool.
    """

    def __init__(self, descriptions: Sequence[ArmDescription], solver: Solver, bases: np.ndarray) -> None:
        """Put arms into the worlds of a solver, in their rest postures.

        Args:
            descriptions: One for each gripper of the solver.
            solver: Its grippers are the TCPs of the arms.
            bases: Where the arms stand, (A, 4, 4).
        """
        self.descriptions = tuple(descriptions)
        self._solver = solver
        num_worlds, num_arms, device = solver.num_worlds, len(descriptions), solver.device
        self._constants = self._upload_chains(device)
        self.rest = self._constants["rest"]
        self.default_bases = torch.as_tensor(_as_transforms(bases), device=device)
        self.bases = self.default_bases.expand(num_worlds, -1, -1).clone()
        shape = (num_worlds, num_arms)
        self.qpos, self.seeds, self.postures, self._next = (self.rest.expand(*shape, -1).clone() for _ in range(4))
        self.qvel = torch.zeros_like(self.qpos)
        self.rotations = torch.zeros(*shape, 4, device=device)
        self.rotations[..., 3] = 1.0
        self.errors = torch.zeros(shape, device=device)
        self.refused = torch.zeros(shape, dtype=torch.bool, device=device)
        self._wanted, self._reached = (torch.zeros(*shape, 3, device=device) for _ in range(2))
        self._link_motions = self._choose_links()
        self._tools = torch.zeros(*shape, 7, device=device)
        with quiet_warp():
            wp.init()
            self._arms = self._fill_struct()
            self._follow = self._record_follow()

    def _choose_links(self) -> LinkMotions:
        """Return where links are written: to what the object meets, or aside where it meets none."""
        solver, links = self._solver, arm_links(self.descriptions)
        if solver.links:
            return solver.link_motions
        return LinkMotions(links, solver.num_worlds, 1, 1, solver.device)

    @property
    def lower(self) -> torch.Tensor:
        """Lower limits of the joints, (A, J) [rad]."""
        return self._constants["lower"]

    @property
    def upper(self) -> torch.Tensor:
        """Upper limits of the joints, (A, J) [rad]."""
        return self._constants["upper"]

    @property
    def speeds(self) -> torch.Tensor:
        """Largest speeds of the joints, (A, J) [rad/s]."""
        return self._constants["speeds"]

    @property
    def accelerations(self) -> torch.Tensor:
        """Largest accelerations of the joints, (A, J) [rad/s^2]."""
        return self._constants["accelerations"]

    def next_range(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the smallest and largest positions of the joints after the next control step, each (B, A, J) [rad]."""
        duration = self._solver.control_dt
        gain = self.accelerations * duration
        fastest = torch.minimum(self.speeds, self.qvel.clamp(min=0.0) + gain)
        slowest = torch.maximum(-self.speeds, self.qvel.clamp(max=0.0) - gain)
        low = torch.maximum(self.lower, self.qpos + slowest * duration)
        return low, torch.minimum(self.upper, self.qpos + fastest * duration)

    def follow(self) -> None:
        """Move all arms by one control step after the targets of the grippers, and these targets to where the TCPs get."""
        self._follow.run()

    def forward(self, qpos: torch.Tensor) -> torch.Tensor:
        """Return where joint positions (B, A, J) bring the TCPs, (B, A, 7): position [m], quaternion (x, y, z, w)."""
        self._launch(forward, qpos.shape[:2], [_warp(qpos.contiguous(), wp.float32), _warp(self._tools, wp.transform)])
        return self._tools.clone()

    def solve(
        self, worlds: torch.Tensor, points: torch.Tensor, rotations: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Find joint positions with which arms of some worlds (b,) hold points (b, A, 3) [m], without time limit.

        Args:
            worlds: (b,) int64.
            points: In the world.
            rotations: Quaternions (x, y, z, w) that the hands are to have, (b, A, 4); any by default.

        Returns:
            Joint positions (b, A, J) [rad], and how far from the points the TCPs stay, (b, A) [m].
        """
        shape, rows = points.shape[:2], 3 if rotations is None else 6
        qpos = torch.zeros(*shape, NUM_JOINTS, device=points.device)
        gaps = torch.zeros(shape, device=points.device)
        if rotations is None:
            rotations = self.rotations[worlds]
        goals = [_warp(worlds.long(), wp.int64), _warp(points.contiguous(), wp.vec3), _warp(rotations.contiguous(), wp.quat)]
        self._launch(place, shape, [*goals, rows, _warp(qpos, wp.float32), _warp(gaps, wp.float32)])
        return qpos, gaps

    def set_qpos(self, worlds: torch.Tensor, arms: slice, qpos: torch.Tensor) -> None:
        """Put arms of some worlds (b,) at rest at joint positions (b, n, J) [rad]."""
        for tensor in (self.qpos, self.seeds):
            tensor[worlds, arms] = qpos
        self.postures[worlds, arms] = self.rest[arms]
        self.qvel[worlds, arms] = 0.0
        self.errors[worlds, arms] = 0.0
        self.refused[worlds, arms] = False
        self.rotations[worlds, arms] = self.forward(self.qpos)[worlds, arms, 3:]

    def hold_rotation(self, arms: slice, is_held: bool) -> None:
        """Say whether the hands of some arms keep the rotation they are told to have, or turn freely about their TCPs."""
        self._constants["holds_rotation"][arms] = int(is_held)

    # ------------------------------------------------------------------ Warp

    def _upload_chains(self, device: torch.device) -> dict[str, torch.Tensor]:
        """Tabulate the chains, padded to J joints that do not move."""
        shape = (len(self.descriptions), NUM_JOINTS)
        tables = {name: np.zeros(shape, dtype=np.float32) for name in ("lower", "upper", "speeds", "rest")}
        tables["accelerations"] = np.full(shape, UNLIMITED, dtype=np.float32)
        kinds, axes = np.full(shape, int(FIXED), dtype=np.int32), np.zeros((*shape, 3), dtype=np.float32)
        offsets, tools = np.tile(np.eye(4), (*shape, 1, 1)), np.tile(np.eye(4), (shape[0], 1, 1))
        for arm, description in enumerate(self.descriptions):
            joints = description.arm_joints
            own = (arm, slice(len(joints)))
            kinds[own] = [int(REVOLUTE) if joint.motion == TURNS else int(PRISMATIC) for joint in joints]
            axes[own] = [joint.axis for joint in joints]
            tables["lower"][own], tables["upper"][own] = [joint.lower for joint in joints], [joint.upper for joint in joints]
            tables["speeds"][own], tables["rest"][own] = [joint.speed for joint in joints], description.rest_qpos
            if description.accelerations is not None:
                tables["accelerations"][own] = description.accelerations
            offsets[own], tools[arm] = description.offsets[:-1], description.offsets[-1]
        arrays = {
            **tables,
            **self._tabulate_capsules(),
            "kinds": kinds,
            "axes": axes,
            "offsets": _as_transforms(offsets),
            "tools": _as_transforms(tools),
            "holds_rotation": np.zeros(shape[0], dtype=np.int32),
        }
        return {name: torch.as_tensor(array, device=device) for name, array in arrays.items()}

    def _tabulate_capsules(self) -> dict[str, np.ndarray]:
        """Tabulate the links that are capsules, padded to as many for each arm, and the columns of the bases."""
        capsules = [link_capsules(description) for description in self.descriptions]
        shape = (len(capsules), max(len(entry) for entry in capsules))
        joints, links = np.full(shape, -1, dtype=np.int32), np.zeros(shape, dtype=np.int32)
        ends, radii = np.zeros((*shape, 2, 3), dtype=np.float32), np.zeros(shape, dtype=np.float32)
        is_fingers = np.zeros(shape, dtype=np.int32)
        first = 0
        for arm, entry in enumerate(capsules):
            own = (arm, slice(len(entry)))
            joints[own], is_fingers[own] = [link.joint for link in entry], [link.is_fingers for link in entry]
            ends[own], radii[own] = [link.capsule.ends for link in entry], [link.capsule.radius for link in entry]
            links[own] = first + np.arange(len(entry))
            first += len(entry)
        columns = [column_capsule(description) for description in self.descriptions]
        return {
            "capsule_joints": joints,
            "capsule_links": links,
            "capsule_is_fingers": is_fingers,
            "capsule_ends": ends.reshape(shape[0], -1, 3),
            "capsule_radii": radii,
            "column_ends": np.stack([column.ends for column in columns]).astype(np.float32),
            "column_radii": np.array([column.radius for column in columns], dtype=np.float32),
        }

    def _fill_struct(self) -> Arms:
        arms = Arms()
        own = {
            **self._constants,
            **{
                name: getattr(self, name)
                for name in ("bases", "qpos", "qvel", "seeds", "postures", "rotations", "errors", "refused")
            },
            **{"next": self._next, "wanted": self._wanted, "reached": self._reached},
        }
        types = {"axes": wp.vec3, "offsets": wp.transform, "tools": wp.transform, "bases": wp.transform, "rotations": wp.quat}
        types |= {"wanted": wp.vec3, "reached": wp.vec3, "kinds": wp.int32, "holds_rotation": wp.int32}
        types |= {"capsule_joints": wp.int32, "capsule_links": wp.int32, "capsule_is_fingers": wp.int32}
        types |= {"capsule_ends": wp.vec3, "column_ends": wp.vec3, "refused": wp.bool}
        for name, tensor in own.items():
            setattr(arms, name, _warp(tensor, types.get(name, wp.float32)))
        return arms

    def _record_follow(self) -> Launches:
        """Record one launch per thread, each over every n-th world."""
        solver = self._solver
        count = choose_num_threads(None, solver.num_worlds, solver.device)
        commands = [
            wp.launch(
                follow_kernel(bool(solver.colliders), any(model.is_rope for model in solver.models)),
                dim=len(range(first, solver.num_worlds, count)),
                inputs=[self._arms, *solver.kernel_data, self._link_motions.data, solver.control_dt, first, count],
                device=str(solver.device),
                record_cmd=True,
            )
            for first in range(count)
        ]
        return Launches(commands, solver.device)

    def _launch(self, kernel: wp.Kernel, dim: tuple[int, ...], inputs: list[wp.array | int]) -> None:
        device = self._solver.device
        stream = wp.stream_from_torch(torch.cuda.current_stream(device)) if device.type == "cuda" else None
        wp.launch(kernel, dim=tuple(dim), inputs=[self._arms, *inputs], device=str(device), stream=stream)


def _warp(tensor: torch.Tensor, dtype: type) -> wp.array:
    return wp.from_torch(tensor, dtype=dtype)


def _as_transforms(matrices: np.ndarray) -> np.ndarray:
    """Return matrices (..., 4, 4) as (..., 7), float32: position, quaternion (x, y, z, w)."""
    quaternions = Rotation.from_matrix(matrices[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    return np.concatenate([matrices[..., :3, 3], quaternions.reshape(*matrices.shape[:-2], 4)], axis=-1).astype(np.float32)
