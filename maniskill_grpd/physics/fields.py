"""The state of a world as one table: what its fields are, which values they may have, and how a rigid motion changes them.

Allocation, the kernel's structs, saving, checking and moving all follow from `FIELDS`: a new field is one line here.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, get_args

import torch
import warp as wp

from maniskill_grpd.physics.leashes import NO_LEASH

STANDARD_GRAVITY = 9.81
# Largest deviation from 1 of the length of a unit vector in a state that is restored: more than rounding leaves.
UNIT_TOLERANCE = 1e-3

Axis = Literal["nodes", "sheet_edges", "grippers", "colliders", "variants"]
Motion = Literal["position", "vector", "plane", "rotation", "scalar"]
"""What a motion x -> R x + t does to a field.

Positions rotate and shift, vectors and quaternions (w, x, y, z) rotate, planes (n, c) with n . x = c move along, scalars stay.
"""


@dataclass(frozen=True, kw_only=True)
class Field:
    """One tensor of the state, (B, *shape, components).

    Attributes:
        dtype: How the kernel reads an entry.
        moves: How it changes when its world is moved.
        shape: What there is an entry for in every world, from the outside in.
        start: Value of an entry before anything is reset.
        low, high: Range of allowed values, both included; an axis as `high` stands for the last index along it.
        is_positive: Whether 0 is excluded too.
        unit: Number of leading components that form a unit vector.
        is_saved: Whether the future depends on it.
        struct: Kernel struct that has it, under its name without the prefix "collider_" for those of colliders.
    """

    dtype: type
    moves: Motion
    shape: tuple[Axis, ...] = ()
    start: float | tuple[float, ...] = 0.0
    low: float = -math.inf
    high: float | Axis = math.inf
    is_positive: bool = False
    unit: int = 0
    is_saved: bool = True
    struct: Literal["worlds", "colliders"] | None = "worlds"

    def __post_init__(self) -> None:
        if self.moves not in get_args(Motion):
            raise ValueError(f"a field moves as one of {get_args(Motion)}, got {self.moves!r}")

    @property
    def num_components(self) -> int:
        """Numbers in one entry."""
        return getattr(self.dtype, "_length_", 1)

    @property
    def array_type(self) -> wp.array:
        """Annotation of the field in a kernel struct."""
        return wp.array(dtype=self.dtype, ndim=1 + len(self.shape))

    def tensor_shape(self, num_worlds: int, sizes: Mapping[str, int]) -> tuple[int, ...]:
        """Return the shape of the tensor, given the size of each axis."""
        components = () if self.num_components == 1 else (self.num_components,)
        return (num_worlds, *(sizes[axis] for axis in self.shape), *components)

    def allocate(self, num_worlds: int, sizes: Mapping[str, int], device: torch.device) -> torch.Tensor:
        """Return the tensor with its start value in all entries."""
        dtype = {wp.int32: torch.int32, wp.bool: torch.bool}.get(self.dtype, torch.float32)
        start = torch.tensor(self.start, dtype=dtype, device=device)
        return start.expand(self.tensor_shape(num_worlds, sizes)).clone()

    def num_bytes(self, sizes: Mapping[str, int]) -> int:
        """Return the memory that one world needs."""
        return math.prod(self.tensor_shape(1, sizes)) * (1 if self.dtype is wp.bool else 4)

    def check(self, name: str, values: torch.Tensor, last: Mapping[str, torch.Tensor]) -> None:
        """Check rows (b, D) of a saved state.

        Args:
            name: What messages call the field.
            values: The rows.
            last: Last index along each axis in each of these worlds, (b,).

        Raises:
            ValueError: If a value is not finite, not a whole number where it has to be, or out of its range.
        """
        high = last[self.high][:, None] if isinstance(self.high, str) else self.high
        is_fine = torch.isfinite(values) & (values >= self.low) & (values <= high)
        if self.is_positive:
            is_fine &= values > 0.0
        if self.dtype in (wp.int32, wp.bool):
            is_fine &= values == values.floor()
        if not is_fine.all():
            raise ValueError(f"{name} must be {self._range(high)}, got {values[~is_fine][0].item():g}")
        if self.unit:
            lengths = values.unflatten(1, (-1, self.num_components))[..., : self.unit].norm(dim=-1)
            if lengths.numel() and not ((lengths - 1.0).abs() <= UNIT_TOLERANCE).all():
                raise ValueError(f"the first {self.unit} numbers of {name} must be a unit vector, got lengths {lengths.tolist()}")

    def _range(self, high: float | torch.Tensor) -> str:
        kind = "a whole number" if self.dtype in (wp.int32, wp.bool) else "finite"
        if isinstance(high, torch.Tensor):
            low, most, least = f"{self.low:g}", int(high.max()), int(high.min())
            return f"{kind} in [{low}, {most}]" + (f", or {least} by the variant of the world" if least < most else "")
        if math.isfinite(high):
            return f"{kind} in [{self.low:g}, {high:g}]"
        if self.is_positive:
            return f"{kind} and > 0"
        return kind if math.isinf(self.low) else f"{kind} and >= {self.low:g}"


NODES: tuple[Axis, ...] = ("nodes",)
GRIPPERS: tuple[Axis, ...] = ("grippers",)
COLLIDERS: tuple[Axis, ...] = ("colliders",)

FIELDS = {
    "positions": Field(dtype=wp.vec3, shape=NODES, moves="position"),
    "velocities": Field(dtype=wp.vec3, shape=NODES, moves="vector"),
    "tensions": Field(dtype=wp.float32, shape=("sheet_edges",), moves="scalar"),
    "inverse_masses": Field(dtype=wp.float32, shape=NODES, moves="scalar", low=0.0),
    "gravity": Field(dtype=wp.vec3, moves="vector", start=(0.0, 0.0, -STANDARD_GRAVITY)),
    "plane": Field(dtype=wp.vec4, moves="plane", start=(0.0, 0.0, 1.0, 0.0), unit=3),
    "friction": Field(dtype=wp.float32, moves="scalar", low=0.0),
    "damping": Field(dtype=wp.float32, moves="scalar", low=0.0),
    "stretch_scale": Field(dtype=wp.float32, moves="scalar", start=1.0, is_positive=True),
    "bend_scale": Field(dtype=wp.float32, moves="scalar", start=1.0, is_positive=True),
    "gripper_positions": Field(dtype=wp.vec3, shape=GRIPPERS, moves="position"),
    "gripper_targets": Field(dtype=wp.vec3, shape=GRIPPERS, moves="position"),
    "gripper_nodes": Field(dtype=wp.int32, shape=GRIPPERS, moves="scalar", start=-1, low=-1, high="nodes"),
    "closed": Field(dtype=wp.bool, shape=GRIPPERS, moves="scalar", low=0, high=1, struct=None),
    "holder": Field(dtype=wp.int32, shape=NODES, moves="scalar", start=-1, low=-1, high="grippers"),
    "hold_offsets": Field(dtype=wp.vec3, shape=NODES, moves="vector"),
    "leashes": Field(dtype=wp.float32, shape=("grippers", "grippers"), moves="scalar", start=NO_LEASH, low=0.0),
    "frozen": Field(dtype=wp.bool, moves="scalar", low=0, high=1),
    "variants": Field(dtype=wp.int32, moves="scalar", low=0, high="variants"),
    "collider_positions": Field(dtype=wp.vec3, shape=COLLIDERS, moves="position", struct="colliders"),
    "collider_rotations": Field(
        dtype=wp.vec4, shape=COLLIDERS, moves="rotation", start=(1.0, 0.0, 0.0, 0.0), unit=4, struct="colliders"
    ),
    "collider_sizes": Field(dtype=wp.vec3, shape=COLLIDERS, moves="scalar", is_positive=True, struct="colliders"),
    "collider_active": Field(dtype=wp.bool, shape=COLLIDERS, moves="scalar", start=1, low=0, high=1, struct="colliders"),
    "crossed_owners": Field(dtype=wp.int32, shape=NODES, moves="scalar", start=-1, low=-1),
    "crossed_elements": Field(dtype=wp.int32, shape=NODES, moves="scalar", start=-1, low=-1),
    "tug_nodes": Field(dtype=wp.int32, moves="scalar", start=-1, low=-1, is_saved=False),
    "tug_targets": Field(dtype=wp.vec3, moves="position", is_saved=False),
    "tug_stiffnesses": Field(dtype=wp.float32, moves="scalar", start=1.0, is_positive=True, is_saved=False),
    "gripper_forces": Field(dtype=wp.vec3, shape=GRIPPERS, moves="vector", is_saved=False),
    "slips": Field(dtype=wp.int32, shape=GRIPPERS, moves="scalar", is_saved=False, struct=None),
    "dropped_contacts": Field(dtype=wp.int32, moves="scalar", is_saved=False, struct=None),
}
"""All fields of the state by name, see `Solver`. Their order is that of a saved state."""


def fields_of_struct(struct: str) -> dict[str, Field]:
    """Return the fields of a kernel struct by their names there."""
    return {name.removeprefix("collider_"): field for name, field in FIELDS.items() if field.struct == struct}
