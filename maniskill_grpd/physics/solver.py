"""The batched solver: owns the state of all worlds and launches the fused kernel."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
import warp as wp

from maniskill_grpd.physics.colliders import Collider
from maniskill_grpd.physics.grasps import Grasps
from maniskill_grpd.physics.kernels.data import Colliders, Objects, Worlds
from maniskill_grpd.physics.kernels.step import build_step_kernel
from maniskill_grpd.physics.launches import Launches, choose_block_dim, choose_num_threads, quiet_warp
from maniskill_grpd.physics.leashes import NO_LEASH
from maniskill_grpd.physics.links import Link, LinkMotions
from maniskill_grpd.physics.model import Model
from maniskill_grpd.physics.scratch import WorldGroups, allocate_self_contacts, allocate_ways
from maniskill_grpd.physics.tugs import Tugs
from maniskill_grpd.physics.upload import choose_features, upload_colliders, upload_objects, upload_timings


class Solver(Grasps, Tugs):
    """XPBD with small substeps for B worlds, each with one of M object variants.

    Every state tensor is allocated once and shared with Warp: write into it, never rebind it. `step()` allocates nothing and does
    not synchronise with the host. World i of a batch does the same arithmetic whatever B and its place in the batch are, so
    trajectories are bitwise reproducible on one device. N is the number of nodes of the largest variant; the rows of smaller
    ones are padded with zeros that never move.

    Attributes:
        models: The variants; `model` is the first.
        substeps: Substeps of each variant in one `step()`, M numbers.
        variants: Variant of each world, (B,) int32, changed by `reset`.
        node_mask: True for nodes, False for padding, (B, N) bool.
        positions: Node positions, (B, N, 3) [m].
        velocities: Node velocities, (B, N, 3) [m/s].
        inverse_masses: (B, N) [1/kg]; 0 fixes a node in space.
        gravity: (B, 3) [m/s^2].
        plane: Table of each world, (B, 4): unit normal n and offset c of the surface n . x = c [m].
        friction: Coulomb coefficient against table and colliders, and of the object with itself, (B,).
        damping: Decay rate of the velocities of free nodes, (B,) [1/s].
        stretch_scale, bend_scale: Factors on the stiffnesses of the model, (B,).
        gripper_positions: (B, A, 3) [m], where the grippers are.
        gripper_targets: (B, A, 3) [m], where they will be after the next step; they move there in a straight line. `step()`
            draws targets together that are further apart than their leash, and stops them at colliders.
        gripper_forces: Mean force with which the object pulled each gripper in the last step, (B, A, 3) [N]: that of the
            constraints on the held nodes and the weight of these, without their inertia.
        gripper_nodes: Node at which each gripper holds, -1 for none, (B, A) int32.
        closed: Grippers that are closed, (B, A) bool; a closed gripper may have caught nothing.
        holder: Gripper that holds each node, -1 for free nodes, (B, N) int32.
        hold_offsets: Position of held nodes relative to their gripper, (B, N, 3) [m].
        leashes: Largest distance between each two grippers, (B, A, A) [m]: the length of the object between what they hold.
        collider_positions: (B, K, 3) [m].
        collider_rotations: Unit quaternions (w, x, y, z), (B, K, 4).
        collider_sizes: (B, K, 3) [m], by kind (see `Collider`).
        collider_active: (B, K) bool; inactive ones are not there.
        tug_nodes: Node that a spring pulls at, -1 for none, (B,) int32; see `tug`.
        tug_targets, tug_stiffnesses: Where it pulls to, (B, 3) [m], and how hard, (B,) [N/m].
        slips: How often since the reset of its world a gripper lost what it held, (B, A) int32, because that pulled harder than
            `grip_strength`. The gripper stays closed, and holds nothing until it has been opened and closes again.
        crossed_owners, crossed_elements: Contacts with itself whose elements have passed through each other, -1 for none,
            (B, N) int32: number of a node, or N plus that of an edge, and of a triangle or edge, in the order of the kernel.
        links: Capsules that move with the arms of grippers.
        link_motions: Where the links of arms are before and after the next step, see `LinkMotions`; no part of the state.
        frozen: Worlds that went non-finite, (B,) bool. They keep their last finite state and are skipped until reset.

        dropped_contacts: How often since its reset a world had more contacts with itself than there is room for, (B,) int32. The
            nearest are kept; what is dropped may pass through.

    Limitations: colliders stand still during a step; a node that touches its own object moves by at most half a
    thickness per substep; friction and damping dissipate momentum; first order in the substep, with
    the numerical damping of implicit integration.
    """

    def __init__(
        self,
        model: Model | Sequence[Model],
        num_worlds: int,
        num_grippers: int = 4,
        *,
        control_dt: float = 0.05,
        substeps: int | None = None,
        device: str | torch.device = "cpu",
        num_threads: int | None = None,
        colliders: Sequence[Collider] = (),
        self_collision: bool = False,
        links: Sequence[Link] = (),
        patch_radius: float = 0.0,
        capture_radius: float = 0.03,
        grip_strength: float | None = None,
    ) -> None:
        """Allocate the state of all worlds, with the first variant at rest in its rest shape and nothing held.

        Args:
            model: The object, or the variants among which `reset` chooses.
            num_worlds: Number of worlds B, >= 1.
            num_grippers: Number of grippers A, >= 1.
            control_dt: Duration of one `step()` [s], > 0.
            substeps: XPBD substeps in one `step()`, >= 1, the same for all variants. More substeps are stiffer and slower. By
                default each variant has what its model needs for a step of 0.05 s, whichever others there are.
            device: "cpu" or a CUDA device.
            num_threads: CPU threads that share the worlds; by default all cores, but at least 16 worlds per thread.
            colliders: Obstacles that every world has, at the origin until `collider_positions` says otherwise.
            self_collision: Let objects collide with themselves.
            links: Capsules that move with the arms of grippers and that the object touches; `link_motions` says where they are.
            patch_radius: Grippers hold all nodes within this distance [m] of the one they close at; 0 holds that node alone, as
                a pivot.
            capture_radius: Distance [m] from which `set_closed` catches a node.
            grip_strength: Force [N], > 0, averaged over a `step()`, beyond which what a gripper holds slips out of it; None for
                any force.

        Raises:
            ValueError: If a number is out of its range.
        """
        for name, value, low in (
            ("num_worlds", num_worlds, 1),
            ("num_grippers", num_grippers, 1),
            ("substeps", 1 if substeps is None else substeps, 1),
            ("patch_radius", patch_radius, 0),
            ("capture_radius", capture_radius, 0),
        ):
            if not value >= low:
                raise ValueError(f"{name} must be >= {low}, got {value}")
        if substeps is not None and int(substeps) != substeps:
            raise ValueError(f"substeps must be a whole number, got {substeps}")
        if not control_dt > 0.0:
            raise ValueError(f"control_dt must be > 0 s, got {control_dt}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be >= 1, got {num_threads}")
        models = (model,) if isinstance(model, Model) else tuple(model)
        if not models:
            raise ValueError("a solver needs at least one model, got none")
        if grip_strength is not None and not (grip_strength > 0.0 and math.isfinite(grip_strength)):
            raise ValueError(f"grip_strength must be finite and > 0 N, or None for unlimited, got {grip_strength}")
        super().__init__(models, num_worlds, num_grippers, tuple(colliders), torch.device(device))
        self.control_dt = control_dt
        self.substeps = tuple(entry.default_substeps if substeps is None else substeps for entry in models)
        self.set_grippers(patch_radius, capture_radius, grip_strength)
        self._features = choose_features(self.models, self.colliders, self_collision, len(links) > 0)
        with quiet_warp():
            wp.init()
            self._groups = WorldGroups(
                self.models,
                num_worlds,
                num_grippers,
                len(self.colliders),
                has_tethers=self._features.tethers,
                touches_itself=self._features.self_contact,
                in_lanes=self._advances_lanes(),
                device=self.device,
            )
            self.links = tuple(links)
            self.link_motions = LinkMotions(links, num_worlds, self._groups.count, self.num_nodes, self.device)
            commands = self._record_commands(choose_num_threads(num_threads, num_worlds, self.device))
        self._launches = Launches(commands, self.device)

    @property
    def kernel_data(self) -> tuple[Objects, Colliders, Worlds]:
        """What kernels of others that move the targets of the grippers read and write: views of the state."""
        return tuple(self._inputs[:3])

    def step(self) -> None:
        """Advance all worlds by `control_dt`; afterwards `gripper_positions` equal `gripper_targets`."""
        self._launches.run()
        if self.grip_strength is not None:
            self._let_slip(self.grip_strength)

    def reset(
        self,
        world_idx: torch.Tensor,
        positions: torch.Tensor | None = None,
        gripper_nodes: torch.Tensor | None = None,
        *,
        variants: torch.Tensor | None = None,
    ) -> None:
        """Put some worlds at rest in given shapes; the other worlds are left bitwise unchanged.

        Args:
            world_idx: Worlds to reset, (b,) int64.
            positions: Their node positions, (b, N, 3) [m], finite in the padding too; the rest shapes by default.
            gripper_nodes: Node at which each gripper closes, (A,) or (b, A) int64, see `grasp`. With None the grippers are opened
                and left where they are.
            variants: Variant of each of these worlds from now on, (b,) int64. Masses, friction, damping and stiffnesses are then
                those of its model. With None variants and materials stay as they are.

        Raises:
            ValueError: If a shape does not fit, a variant does not exist, or a position is not finite.
        """
        if variants is not None:
            self._set_variants(world_idx, variants)
        if positions is None:
            positions = self._rest_positions[self.variants[world_idx].long()]
        expected = (len(world_idx), self.num_nodes, 3)
        if tuple(positions.shape) != expected:
            raise ValueError(f"positions must be {expected} for {len(world_idx)} worlds, got {tuple(positions.shape)}")
        if not torch.isfinite(positions).all():
            raise ValueError("positions must be finite, got NaN or infinity")
        self.positions[world_idx] = positions.to(self.positions)
        if len(self.models) > 1:
            self.positions[world_idx] *= self.node_mask[world_idx, :, None]
        self.velocities[world_idx] = 0.0
        self.tensions[world_idx] = 0.0
        self.frozen[world_idx] = False
        self.dropped_contacts[world_idx] = 0
        self.slips[world_idx] = 0
        self.crossed_owners[world_idx] = -1
        self.crossed_elements[world_idx] = -1
        self.holder[world_idx] = -1
        self.hold_offsets[world_idx] = 0.0
        self.leashes[world_idx] = NO_LEASH
        self.gripper_nodes[world_idx] = -1
        self.closed[world_idx] = False
        self.gripper_forces[world_idx] = 0.0
        self.let_go(world_idx)
        if gripper_nodes is not None:
            self.grasp(world_idx, gripper_nodes)

    def set_material(
        self,
        world_idx: torch.Tensor,
        *,
        stretch: float | torch.Tensor | None = None,
        bend: float | torch.Tensor | None = None,
        mass: float | torch.Tensor | None = None,
        friction: float | torch.Tensor | None = None,
        damping: float | torch.Tensor | None = None,
    ) -> None:
        """Give some worlds another material, as factors on the values of their models; what is None stays as it is.

        Args:
            world_idx: Worlds to change, (b,) int64.
            stretch: Factor on the stretch stiffness, > 0, a number or (b,), as all of these.
            bend: Factor on the bending stiffness, > 0.
            mass: Factor on all masses, > 0. Nodes that were fixed by a zero inverse mass come free.
            friction: Factor on the friction, >= 0.
            damping: Factor on the damping, >= 0.

        Raises:
            ValueError: If a factor is not finite or out of its range.
        """
        variant = self.variants[world_idx].long()
        if stretch is not None:
            self.stretch_scale[world_idx] = self._factor("stretch", stretch, len(world_idx), positive=True)
        if bend is not None:
            self.bend_scale[world_idx] = self._factor("bend", bend, len(world_idx), positive=True)
        if mass is not None:
            factor = self._factor("mass", mass, len(world_idx), positive=True)
            self.inverse_masses[world_idx] = self._inverse_masses[variant] / factor[:, None]
        if friction is not None:
            self.friction[world_idx] = self._friction[variant] * self._factor("friction", friction, len(world_idx))
        if damping is not None:
            self.damping[world_idx] = self._damping[variant] * self._factor("damping", damping, len(world_idx))

    def _set_variants(self, world_idx: torch.Tensor, variants: torch.Tensor) -> None:
        if tuple(variants.shape) != (len(world_idx),):
            raise ValueError(f"variants must be ({len(world_idx)},), got {tuple(variants.shape)}")
        if len(variants) and not (variants.min() >= 0 and variants.max() < len(self.models)):
            raise ValueError(f"variants must be in [0, {len(self.models) - 1}], got {variants.min()} to {variants.max()}")
        variants = variants.to(self.device, torch.int64)
        self.variants[world_idx] = variants.to(torch.int32)
        self._groups.assign(self.variants)
        self.node_mask[world_idx] = self._node_masks[variants]
        self.inverse_masses[world_idx] = self._inverse_masses[variants]
        self.friction[world_idx] = self._friction[variants]
        self.damping[world_idx] = self._damping[variants]
        self.stretch_scale[world_idx] = 1.0
        self.bend_scale[world_idx] = 1.0

    def _factor(self, name: str, value: float | torch.Tensor, count: int, *, positive: bool = False) -> torch.Tensor:
        factor = torch.as_tensor(value, dtype=torch.float32, device=self.device).expand(count)
        low = factor > 0.0 if positive else factor >= 0.0
        if not (torch.isfinite(factor) & low).all():
            raise ValueError(f"the factor on {name} must be finite and {'> 0' if positive else '>= 0'}, got {value}")
        return factor

    def set_state(self, state: dict[str, torch.Tensor], world_idx: torch.Tensor | None = None) -> None:
        """Restore what `state()` returned, see `WorldState.set_state`."""
        super().set_state(state, world_idx)
        self._groups.assign(self.variants)

    def _record_commands(self, num_threads: int) -> list[wp.Launch]:
        """Record one launch per thread, each over every `num_threads`-th group of worlds."""
        device = str(self.device)
        objects = upload_objects(self.models, wp.from_torch(self._geodesics, dtype=wp.float32), device)
        colliders, meshes = upload_colliders(self.colliders, device)
        worlds = Worlds()
        structs = {"worlds": worlds, "colliders": colliders}
        for name, (field, tensor) in self.fields.items():
            if field.struct is not None and tensor.numel():
                setattr(structs[field.struct], name.removeprefix("collider_"), wp.from_torch(tensor, dtype=field.dtype))
        if self.colliders and self._features.ropes:
            allocate_ways(worlds, self.num_worlds, self.num_grippers, self.device)
        contacts = allocate_self_contacts(self.models, self.num_worlds, self._features.self_contact, self.device)
        timings = upload_timings(self.substeps, self.control_dt, device)
        contacts.dropped = wp.from_torch(self.dropped_contacts, dtype=wp.int32)
        self._uploaded = [objects, colliders, meshes, worlds, contacts]  # alive as long as launches refer to it
        self._inputs = [objects, colliders, worlds, self._groups.data, contacts, self.link_motions.data, timings]
        num_threads = min(num_threads, self._groups.count)
        return [self._record_command(part, num_threads, 0, 1) for part in range(num_threads)]

    def _advances_lanes(self) -> bool:
        """Whether many worlds are advanced in the lanes of one thread, rather than one by the threads of a block."""
        return self.device.type == "cpu"

    def _record_command(self, first_group: int, group_stride: int, first_thread: int, thread_stride: int) -> wp.Launch:
        """Record a launch over every `group_stride`-th group, for every `thread_stride`-th part of the work on each."""
        block_dim = choose_block_dim(self.num_nodes, self.device)
        return wp.launch(
            build_step_kernel(self._features, self._groups.in_lanes),
            dim=(len(range(first_group, self._groups.count, group_stride)), block_dim),
            inputs=[*self._inputs, first_group, group_stride, first_thread, thread_stride],
            device=str(self.device),
            block_dim=block_dim,
            record_cmd=True,
        )
