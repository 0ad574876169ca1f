"""A bar over which a cloth is draped."""

from __future__ import annotations

import numpy as np
import torch

from maniskill_grpd.physics import Solver, capsule
from maniskill_grpd.tasks.hanger import Hanger, Hanging, distances_to_segment, way_to_go
from maniskill_grpd.tasks.loop_geometry import loop_area, loop_centre


class BarHanger(Hanger):
    """A bar that is horizontal or nearly so. Its point is its middle, its axis points to one of its ends."""

    LENGTH = 0.6
    """From end to end [m]."""
    RADIUS = 0.01
    """Half its thickness [m]."""
    LARGEST_SLOPE = np.deg2rad(15.0)
    """Largest angle between bar and horizontal [rad]."""

    LARGEST_GAP = 0.05
    """Success: largest distance of the middle of the cloth from the bar's axis [m]."""
    SMALLEST_SHARE = 0.35
    """Success: smallest share of the cloth's mass that hangs on either side."""

    radius = RADIUS
    distances = (0.85, 0.95)

    def __init__(self) -> None:
        self.colliders = (capsule(self.RADIUS, self.LENGTH / 2.0 - self.RADIUS),)

    def draw_axes(self, draws: torch.Tensor, share: float) -> torch.Tensor:
        """See `Hanger.draw_axes`: a turn about the vertical of up to a right angle either way, from y, then a slope."""
        turn, slope = 0.5 * torch.pi * share * draws[:, 0], self.LARGEST_SLOPE * share * draws[:, 1]
        return torch.stack([-turn.sin() * slope.cos(), turn.cos() * slope.cos(), slope.sin()], dim=-1)

    def place(self, middles: torch.Tensor, axes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See `Hanger.place`."""
        return middles, middles[:, None]

    def offsets(self, points: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """See `Hanger.offsets`: the way to the nearest point of the bar's axis."""
        offset = points - point[:, None]
        half = self.LENGTH / 2.0
        along = (offset * axis[:, None]).sum(-1, keepdim=True).clamp(-half, half)
        return along * axis[:, None] - offset

    def distances_to(self, points: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """See `Hanger.distances_to`."""
        half = self.LENGTH / 2.0 - self.RADIUS
        return distances_to_segment(points, point - half * axis, 2.0 * half * axis) - self.RADIUS

    def measure(self, solver: Solver, loop: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> Hanging:
        """See `Hanger.measure`; the seat is a disc about the middle of the cloth.

        Above and below mean along the upward direction perpendicular to the bar.
        """
        up = -solver.gravity - (-solver.gravity * axis).sum(-1, keepdim=True) * axis
        up = torch.nn.functional.normalize(up, dim=-1)
        offset = self.offsets(loop_centre(loop)[:, None], point, axis)[:, 0]
        height = -(offset * up).sum(-1)
        aside = torch.linalg.vector_norm(offset + height[:, None] * up, dim=-1)
        gap = torch.linalg.vector_norm(offset, dim=-1)
        crossing, hanging = self._shares(solver, point, axis, up)
        is_over = (height >= 0.0) & (gap <= self.LARGEST_GAP)
        return Hanging(
            offset=offset,
            normal=torch.nn.functional.normalize(loop_area(loop), dim=-1),
            depth=-height,
            way=way_to_go(height, aside),
            alignment=2.0 * crossing,
            progress=torch.where(is_over, (hanging / self.SMALLEST_SHARE).clamp(max=1.0), 0.0),
            is_hung=is_over & (hanging >= self.SMALLEST_SHARE),
            measures={"hanging_share": hanging, "bar_gap": gap},
        )

    @staticmethod
    def _shares(
        solver: Solver, point: torch.Tensor, axis: torch.Tensor, up: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the smaller of the shares of mass on the two sides of the bar, at any height and below it, each (B,)."""
        offset = solver.positions - point[:, None]
        side = (offset * torch.linalg.cross(axis, up)[:, None]).sum(-1)
        is_below = (offset * up[:, None]).sum(-1) < 0.0
        mass = torch.where(solver.node_mask, 1.0 / solver.inverse_masses.clamp(min=1e-9), 0.0)
        mass = mass / mass.sum(dim=1, keepdim=True)

        def smaller(counts: torch.Tensor) -> torch.Tensor:
            return torch.minimum((mass * (counts & (side > 0.0))).sum(1), (mass * (counts & (side <= 0.0))).sum(1))

        return smaller(torch.ones_like(is_below)), smaller(is_below)
