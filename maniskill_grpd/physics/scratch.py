"""Memory of the fused kernel beside the state: groups of worlds, contacts. Only who is in which group outlives a step."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import warp as wp

from maniskill_grpd.physics.kernel_data import Features, LaneGroups, SelfContacts, SingleGroups, Touch
from maniskill_grpd.physics.lanes import WIDTH
from maniskill_grpd.physics.model import Model
from maniskill_grpd.physics.self_contact_functions import BLOCK, MAX_CONTACTS_PER_NODE, SLOTS


class WorldGroups:
    """The groups in which worlds are advanced together: up to `WIDTH` worlds of one variant on CPU, single ones on CUDA.

    Attributes:
        count: Number of groups, some of which may be empty.
        data: What the kernel gets.
    """

    def __init__(
        self, models: Sequence[Model], num_worlds: int, num_grippers: int, features: Features, device: torch.device
    ) -> None:
        """Allocate groups for the worst mixture of variants."""
        self.in_lanes = device.type == "cpu"
        self._width = WIDTH if self.in_lanes else 1
        partial = min(len(models), num_worlds)  # every variant may have a group that is not full
        self.count = min((num_worlds + (self._width - 1) * partial) // self._width, num_worlds)
        self._members = torch.zeros(self.count, self._width, dtype=torch.int32, device=device)
        self._counts = torch.zeros(self.count, dtype=torch.int32, device=device)
        self.assign(torch.zeros(num_worlds, dtype=torch.int32, device=device))

        numbers, vectors = ((WIDTH,), (3 * WIDTH,)) if self.in_lanes else ((), (3,))
        number, vector = (wp.types.vector(WIDTH, wp.float32), wp.types.vector(3 * WIDTH, wp.float32)) if self.in_lanes else (
            wp.float32, wp.vec3)  # fmt: skip

        def scratch(kind: str, *columns: int) -> wp.array:
            lanes, dtype = (numbers, number) if kind == "number" else (vectors, vector)
            return wp.from_torch(torch.zeros(*columns, *lanes, device=device), dtype=dtype)

        nodes = max(model.num_nodes for model in models)
        edges = max(len(model.edges) for model in models)
        tethered = nodes if features.tethers else 1
        columns = {
            "gravity": 1, "table_normals": 1, "positions": nodes, "previous": nodes, "velocities": nodes, "reactions": nodes,
            "hold_starts": nodes, "hold_motions": nodes, "hold_offsets": nodes, "pulls": num_grippers,
            "tether_ends": num_grippers, "directions": edges,
        }  # fmt: skip
        number_columns = {
            "table_offsets": 1, "friction": 1, "decays": 1, "stretch_rates": 1, "bend_rates": 1, "weights": nodes, "held": nodes,
            "upper": edges, "multipliers": edges,
        }  # fmt: skip
        self.data = (LaneGroups if self.in_lanes else SingleGroups)()
        self.data.members = wp.from_torch(self._members, dtype=wp.int32)
        self.data.counts = wp.from_torch(self._counts, dtype=wp.int32)
        for name, width in columns.items():
            setattr(self.data, name, scratch("vector", self.count, width))
        for name, width in number_columns.items():
            setattr(self.data, name, scratch("number", self.count, width))
        self.data.tether_lengths = scratch("number", num_grippers, self.count, tethered)
        self.data.tether_impulses = scratch("vector", num_grippers, self.count, tethered)
        for name, width in (("is_free", nodes), ("is_held", nodes), ("has_tethers", num_grippers)):
            setattr(self.data, name, wp.zeros((self.count, width), dtype=wp.bool, device=str(device)))

    def assign(self, variants: torch.Tensor) -> None:
        """Put worlds into groups of one variant each; `variants` (B,) int32."""
        self._counts.zero_()
        group = 0
        for variant in torch.unique(variants) if self.in_lanes else [None]:
            worlds = torch.arange(len(variants), device=variants.device)
            if variant is not None:
                worlds = worlds[variants == variant]
            for members in worlds.to(torch.int32).split(self._width):
                self._members[group] = members[0]
                self._members[group, : len(members)] = members
                self._counts[group] = len(members)
                group += 1


def allocate_touch(num_worlds: int, num_nodes: int, used: bool, device: torch.device) -> Touch:
    """Allocate scratch of single worlds for contact."""
    touch, shape = Touch(), (num_worlds, num_nodes if used else 1)
    for name in ("positions", "previous", "velocities", "reactions"):
        setattr(touch, name, wp.zeros(shape, dtype=wp.vec3, device=str(device)))
    touch.weights = wp.zeros(shape, dtype=wp.float32, device=str(device))
    return touch


def allocate_self_contacts(num_worlds: int, num_nodes: int, used: bool, device: torch.device) -> SelfContacts:
    """Allocate the slots for contacts of objects with themselves."""
    nodes = num_nodes if used else 1
    slots, blocks = nodes * SLOTS, 2 * nodes // BLOCK + 1  # a cloth has less than two triangles for each node
    shapes = {
        "nodes": ((slots,), wp.vec4i), "sides": ((slots,), wp.float32), "gaps": ((slots,), wp.float32),
        "weights": ((slots,), wp.vec4), "impulses": ((slots,), wp.vec3), "counts": ((nodes,), wp.int32),
        "of_node": ((nodes, MAX_CONTACTS_PER_NODE), wp.int32), "num_of_node": ((nodes,), wp.int32),
        "num_active": ((nodes,), wp.int32), "block_spheres": ((blocks,), wp.vec4), "block_motions": ((blocks,), wp.vec4),
        "cluster_spheres": ((blocks // BLOCK + 1,), wp.vec4),
    }  # fmt: skip
    contacts = SelfContacts()
    for name, (shape, dtype) in shapes.items():
        setattr(contacts, name, wp.zeros((num_worlds, *shape), dtype=dtype, device=str(device)))
    return contacts
