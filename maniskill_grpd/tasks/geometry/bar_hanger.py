"""A bar over which a cloth is draped."""

from __future__ import annotations

import numpy as np
import torch

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Solver, capsule
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
from maniskill_grpd.tasks.geometry.loop_geometry import loop_area, loop_centre


class BarHanger(Hanger):
    """A bar that is horizontal or nearly so. Its point is its middle, its axis points to one of its ends."""

    LENGTH = 0.6
    """From end to end [m]."""
    RADIUS = 0.01
    """Half its thickness [m]."""
    LARGEST_SLOPE = np.deg2rad(15.0)
    """Largest angle between bar and horizontal [rad]."""

    LARGEST_GAP = 0.05
    """Success: largest distance of the middle of the cloth from the bar's axis [m]; draped, it is the middle of a bent disc."""
    CROSSING_REACH = 0.04
    """Success: within this distance above or below the bar's axis [m] the cloth crosses the bar, above it only."""
    SMALLEST_SHARE = 0.25
    """Success: smallest share of the cloth's mass that hangs on either side."""

    radius = RADIUS
    distances = (0.85, 0.95)
    channels = (
        Channel(OFFSET, "vector", "m", OFFSET_SOURCE, starts_at="node", across="hanger_axis"),
        Channel(DISTANCE, "scalar", "m", DISTANCE_SOURCE, distance_of=OFFSET),
    )

    def __init__(self) -> None:
        self.colliders = (capsule(self.RADIUS, self.LENGTH / 2.0 - self.RADIUS),)

    def attach(self, solver: Solver) -> None:
        """See `Hanger.attach`: the edges of all variants, padded by edges from a node to itself, which cross nothing."""
        edges = [model.surface_edges for model in solver.models]
        table = np.zeros((len(edges), max(len(entry) for entry in edges), 2), np.int64)
        for index, entry in enumerate(edges):
            table[index, : len(entry)] = entry
        self._edges = torch.as_tensor(table, device=solver.device)

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
        nodes = solver.positions - point[:, None]
        heights, sides = (nodes * up[:, None]).sum(-1), (nodes * torch.linalg.cross(axis, up)[:, None]).sum(-1)
        is_over = self._is_over(solver, heights, sides, (nodes * axis[:, None]).sum(-1))
        lies = is_over & (gap <= self.LARGEST_GAP)
        share = _smaller_share(solver, sides, torch.ones_like(solver.node_mask))
        hanging = _smaller_share(solver, sides, heights < 0.0)
        return Hanging(
            offset=offset,
            normal=facing(torch.nn.functional.normalize(loop_area(loop), dim=-1), up),
            depth=-height,
            way=torch.where(lies, 0.0, way_to_go(height, aside)),
            alignment=2.0 * share,
            progress=progress_of(offset, lies, (hanging / self.SMALLEST_SHARE).clamp(max=1.0)),
            is_on=lies,
            is_hung=lies & (hanging >= self.SMALLEST_SHARE),
            measures={"lies_on_bar": lies, "hanging_share": hanging, "bar_gap": gap},
        )

    def _is_over(self, solver: Solver, heights: torch.Tensor, sides: torch.Tensor, along: torch.Tensor) -> torch.Tensor:
        """Return whether the cloth crosses the vertical plane through the bar close to it, and above it only, (B,) bool.

        Further below the two halves may swing through the plane.

        Args:
            solver: The worlds.
            heights: Height of the nodes above the bar's axis, (B, N) [m].
            sides: Their distance from the plane, positive on one side, (B, N) [m].
            along: Their place along the bar, 0 at its middle, (B, N) [m].
        """
        edges = self._edges[solver.variants.long()].flatten(1)
        ends = [values.gather(1, edges).unflatten(1, (-1, 2)) for values in (heights, sides, along)]
        height, side, place = ends
        is_crossing = (side[..., 0] > 0.0) != (side[..., 1] > 0.0)
        fraction = side[..., 0] / torch.where(is_crossing, side[..., 0] - side[..., 1], 1.0)
        crossing_height = height[..., 0] + fraction * (height[..., 1] - height[..., 0])
        crossing_place = place[..., 0] + fraction * (place[..., 1] - place[..., 0])
        is_crossing &= (crossing_place.abs() <= self.LENGTH / 2.0) & (crossing_height.abs() <= self.CROSSING_REACH)
        return is_crossing.any(dim=1) & ~(is_crossing & (crossing_height < 0.0)).any(dim=1)


def _smaller_share(solver: Solver, sides: torch.Tensor, counts: torch.Tensor) -> torch.Tensor:
    """Return the share of the cloth's mass that is on a side of the bar and counts (B, N), the smaller of the two, (B,)."""
    mass = torch.where(solver.node_mask, 1.0 / solver.inverse_masses.clamp(min=1e-9), 0.0)
    mass = mass / mass.sum(dim=1, keepdim=True)
    return torch.minimum((mass * (counts & (sides > 0.0))).sum(1), (mass * (counts & (sides <= 0.0))).sum(1))
