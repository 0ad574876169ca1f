"""A peg on a round plate, for cloths with a hole."""

from __future__ import annotations

import numpy as np
import torch

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Solver, capsule, cylinder
from maniskill_grpd.tasks.geometry.direction_draws import directions_in_cap
from maniskill_grpd.tasks.geometry.hanger import (
    DISTANCE,
    DISTANCE_SOURCE,
    OFFSET,
    OFFSET_SOURCE,
    Hanger,
    Hanging,
    distances_to_segment,
    facing,
    progress_of,
    way_to_go,
)
from maniskill_grpd.tasks.geometry.loop_geometry import loop_area, loop_centre, winding_about_axis


class PegHanger(Hanger):
    """A peg. Its point is its tip, its axis points out of the tip.

    The plate at its foot is wide enough that the hole cannot slip over it, not even edgewise: 2 (2 R + 2 cm) is longer than the
    hole's boundary stretched by 3 %, for R = 1.7 times the hole's radius.

    Args:
        hole_radius: Radius of the hole [m].
        largest_tilt: Largest angle between the axis and the vertical [rad].
    """

    LENGTH = 0.25
    """From the plate to the tip [m]."""
    RADIUS = 0.015
    """Half the thickness of the peg [m]. With the cloth's it is more than the inner circle of a triangle at 100 nodes (1.3 cm): a
    thinner peg would pierce between the edges, which are what touches it."""
    PLATE_RADIUS_PER_HOLE_RADIUS = 1.7
    PLATE_HALF_THICKNESS = 0.01
    """[m]."""

    HUNG_DEPTH = 0.08
    """Success: how far from the tip the middle of the hole must have come along the axis [m]."""
    LARGEST_ANGLE = np.deg2rad(35.0)
    """Success: largest angle between the hole's normal and the axis, up to sign [rad]."""

    radius = RADIUS
    distances = (0.75, 0.85)
    channels = (
        Channel(OFFSET, "vector", "m", OFFSET_SOURCE, starts_at="node"),
        Channel(DISTANCE, "scalar", "m", DISTANCE_SOURCE),  # from the side of the peg: not the length of the offset
    )

    def __init__(self, hole_radius: float, largest_tilt: float) -> None:
        self.plate_radius = self.PLATE_RADIUS_PER_HOLE_RADIUS * hole_radius
        self.colliders = (
            capsule(self.RADIUS, self.LENGTH / 2.0 - self.RADIUS),
            cylinder(self.plate_radius, self.PLATE_HALF_THICKNESS),
        )
        self._largest_tilt = largest_tilt

    def draw_axes(self, draws: torch.Tensor, share: float) -> torch.Tensor:
        """See `Hanger.draw_axes`: uniform on a cap of the sphere about the vertical."""
        return directions_in_cap(draws, share * self._largest_tilt)

    def place(self, middles: torch.Tensor, axes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See `Hanger.place`."""
        half = self.LENGTH / 2.0
        plates = middles - (half + self.PLATE_HALF_THICKNESS) * axes
        return middles + half * axes, torch.stack([middles, plates], dim=1)

    def offsets(self, points: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """See `Hanger.offsets`: the way to the tip."""
        return point[:, None] - points

    def distances_to(self, points: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """See `Hanger.distances_to`."""
        return distances_to_segment(points, point - self.RADIUS * axis, (2.0 * self.RADIUS - self.LENGTH) * axis) - self.RADIUS

    def measure(self, solver: Solver, loop: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> Hanging:
        """See `Hanger.measure`; the seat is the hole."""
        offset = point - loop_centre(loop)
        depth = (offset * axis).sum(-1)
        aside = torch.linalg.vector_norm(offset - depth[:, None] * axis, dim=-1)
        normal = facing(torch.nn.functional.normalize(loop_area(loop), dim=-1), axis)
        alignment = (normal * axis).sum(-1).clamp(max=1.0)
        is_pierced = winding_about_axis(loop, point, axis).abs() > 0.5
        is_threaded = is_pierced & (depth > 0.0) & (depth < self.LENGTH)
        is_hung = is_threaded & (depth >= self.HUNG_DEPTH) & (alignment >= np.cos(self.LARGEST_ANGLE))
        return Hanging(
            offset=offset,
            normal=normal,
            depth=depth,
            way=torch.where(is_threaded, 0.0, way_to_go(-depth, aside)),
            alignment=alignment,
            progress=progress_of(offset, is_threaded, (depth / self.HUNG_DEPTH).clamp(0.0, 1.0)),
            is_on=is_threaded,
            is_hung=is_hung,
            measures={"is_threaded": is_threaded, "hole_depth": depth, "hole_angle": torch.acos(alignment)},
        )
