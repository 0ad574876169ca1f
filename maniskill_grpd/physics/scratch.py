"""Memory of the fused kernel beside the state: groups of worlds, contacts. Only who is in which group outlives a step."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp

from maniskill_grpd.physics.kernels.contact_search import BLOCK, SLOTS
from maniskill_grpd.physics.kernels.data import LaneGroups, SelfContacts, SingleGroups, Worlds
from maniskill_grpd.physics.kernels.lanes import WIDTH, Numbers, Vectors
from maniskill_grpd.physics.launches import LARGE_BLOCK_DIM
from maniskill_grpd.physics.model import Model

# Contacts of an object with itself for which there is room in a world, for each of its nodes.
CONTACTS_PER_NODE = 40


class WorldGroups:
    """The groups in which worlds are advanced together: up to `WIDTH` worlds of one variant on CPU, single ones on CUDA.

    Attributes:
        count: Number of groups, enough for the worst mixture of variants; some may be empty.
        in_lanes: Whether groups have lanes.
        data: What the kernel gets.
    """

    def __init__(
        self,
        models: Sequence[Model],
        num_worlds: int,
        num_grippers: int,
        num_colliders: int,
        *,
        has_tethers: bool,
        touches_itself: bool,
        in_lanes: bool,
        device: torch.device,
    ) -> None:
        """Allocate all groups, with the first variant in all worlds."""
        self.in_lanes = in_lanes
        self._num_variants = len(models)
        self._device = device
        self._width = WIDTH if self.in_lanes else 1
        partial = min(len(models), num_worlds)  # every variant may have a group that is not full
        self.count = min((num_worlds + (self._width - 1) * partial) // self._width, num_worlds)
        self._members = torch.zeros(self.count, self._width, dtype=torch.int32, device=device)
        self._counts = torch.zeros(self.count, dtype=torch.int32, device=device)
        self.assign(torch.zeros(num_worlds, dtype=torch.int32, device=device))
        self.data = (LaneGroups if self.in_lanes else SingleGroups)()
        self.data.members = wp.from_torch(self._members, dtype=wp.int32)
        self.data.counts = wp.from_torch(self._counts, dtype=wp.int32)
        nodes, edges = max(model.num_nodes for model in models), max(len(model.edges) for model in models)
        self._allocate_columns(nodes, edges, num_grippers, nodes if has_tethers else 1)
        self._allocate_colliders(num_colliders, nodes)
        elements = max(len(model.faces) + len(model.surface_edges) for model in models) if touches_itself else 1
        self._allocate_elements(elements, nodes if touches_itself else 1)

    def assign(self, variants: torch.Tensor) -> None:
        """Put worlds into groups of one variant each, without looking at single worlds from Python; `variants` (B,) int32."""
        variant, order = torch.sort(variants.long(), stable=True)
        num_worlds = torch.bincount(variant, minlength=self._num_variants)
        num_groups = (num_worlds + self._width - 1) // self._width
        first_world, first_group = num_worlds.cumsum(0) - num_worlds, num_groups.cumsum(0) - num_groups
        place = torch.arange(len(variant), device=self._device) - first_world[variant]
        group, lane = first_group[variant] + place // self._width, place % self._width
        self._members[group, lane] = order.to(torch.int32)
        self._counts.copy_(torch.bincount(group, minlength=self.count))
        is_taken = torch.arange(self._width, device=self._device) < self._counts[:, None]
        # Lanes without a world of their own repeat the first.
        self._members.copy_(torch.where(is_taken, self._members, self._members[:, :1]))

    def _allocate_columns(self, nodes: int, edges: int, grippers: int, tethered: int) -> None:
        columns = {
            "gravity": 1,
            "table_normals": 1,
            "positions": nodes,
            "previous": nodes,
            "velocities": nodes,
            "reactions": nodes,
            "hold_starts": nodes,
            "hold_motions": nodes,
            "hold_offsets": nodes,
            "pulls": grippers,
            "tether_ends": grippers,
            "directions": edges,
            "straightened": nodes,
        }
        for name, width in columns.items():
            setattr(self.data, name, self._vectors(self.count, width))
        columns = {
            "table_offsets": 1,
            "friction": 1,
            "decays": 1,
            "stretch_rates": 1,
            "bend_rates": 1,
            "weights": nodes,
            "held": nodes,
            "upper": edges,
            "carried": edges,
            "multipliers": edges,
        }
        for name, width in columns.items():
            setattr(self.data, name, self._numbers(self.count, width))
        for name, width in (("is_free", nodes), ("is_held", nodes), ("has_tethers", grippers)):
            setattr(self.data, name, wp.zeros((self.count, width), dtype=wp.bool, device=str(self._device)))
        self.data.tether_lengths = self._numbers(grippers, self.count, tethered)
        self.data.tether_impulses = self._vectors(grippers, self.count, tethered)

    def _allocate_colliders(self, count: int, nodes: int) -> None:
        self.data.collider_positions = self._vectors(self.count, max(count, 1))
        self.data.collider_axes = self._vectors(self.count, 3 * max(count, 1))
        self.data.collider_lows = self._numbers(self.count, 3 * max(count, 1))
        self.data.collider_highs = self._numbers(self.count, 3 * max(count, 1))
        self.data.nearness = self._numbers(self.count, nodes if count else 1)

    def _allocate_elements(self, count: int, nodes: int) -> None:
        blocks = count // BLOCK + 2  # triangles and edges fill blocks of their own
        self.data.element_centers, self.data.element_radii = self._vectors(self.count, count), self._numbers(self.count, count)
        self.data.block_centers, self.data.block_radii = self._vectors(self.count, blocks), self._numbers(self.count, blocks)
        self.data.anchors, self.data.touching = self._vectors(self.count, nodes), self._numbers(self.count, nodes)
        self.data.searched = self._numbers(self.count, 1)
        threads = 1 if self.in_lanes else LARGE_BLOCK_DIM
        self.data.lowest_motions = self._vectors(self.count, threads)
        self.data.highest_motions = self._vectors(self.count, threads)

    # PyTorch aligns memory with cache lines, and so with vector registers.
    def _numbers(self, *shape: int) -> wp.array:
        lanes, dtype = ((WIDTH,), Numbers) if self.in_lanes else ((), wp.float32)
        return wp.from_torch(torch.zeros(*shape, *lanes, device=self._device), dtype=dtype)

    def _vectors(self, *shape: int) -> wp.array:
        components, dtype = (3 * WIDTH, Vectors) if self.in_lanes else (3, wp.vec3)
        return wp.from_torch(torch.zeros(*shape, components, device=self._device), dtype=dtype)


def allocate_ways(worlds: Worlds, num_worlds: int, num_grippers: int, device: torch.device) -> None:
    """Allocate where ropes touch colliders between each two grippers."""
    for name, dtype in (("starts", wp.vec3), ("ends", wp.vec3), ("lengths", wp.float32), ("spans", wp.vec2)):
        setattr(worlds, f"way_{name}", wp.zeros((num_worlds, num_grippers**2), dtype=dtype, device=str(device)))


def allocate_self_contacts(models: Sequence[Model], num_worlds: int, used: bool, device: torch.device) -> SelfContacts:
    """Allocate the list of contacts of objects with themselves; `used` is False for a solver without any."""
    nodes = max(model.num_nodes for model in models) if used else 1
    owners = nodes + max(len(model.surface_edges) for model in models) if used else 1
    room = CONTACTS_PER_NODE * nodes + 2 * WIDTH
    shapes = {
        "found": ((owners * SLOTS,), wp.int32),
        "found_gaps": ((owners * SLOTS,), wp.float32),
        "found_reaches": ((owners,), wp.float32),
        "anchors": ((nodes,), wp.vec3),
        **dict.fromkeys(("motions", "travels", "slacks", "reaches"), ((), wp.float32)),
        **dict.fromkeys(("num_pairs", "first_edges", "num_contacts", "first_edge_contacts", "num_sweeps"), ((), wp.int32)),
        **dict.fromkeys(("found_counts", "starts", "ends", "old_starts", "old_ends"), ((owners + 1,), wp.int32)),
        **dict.fromkeys(("pair_nodes", "nodes"), ((room,), wp.vec4i)),
        **dict.fromkeys(("owners", "elements", "old_elements", "pairs"), ((room,), wp.int32)),
        **dict.fromkeys(("wakes", "pair_thicknesses", "pair_distances"), ((room,), wp.float32)),
        **dict.fromkeys(("thicknesses", "distances", "lengths", "insides", "masses"), ((room,), wp.float32)),
        **dict.fromkeys(("pair_normals", "old_normals", "normals", "starts_of_gaps"), ((room,), wp.vec3)),
    }
    contacts = SelfContacts()
    for name, (shape, dtype) in shapes.items():
        setattr(contacts, name, wp.zeros((num_worlds, *shape), dtype=dtype, device=str(device)))
    contacts.weights = wp.zeros((4, num_worlds, room), dtype=wp.float32, device=str(device))
    return contacts
