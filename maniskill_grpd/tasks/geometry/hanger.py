"""What a cloth can be hung on: the interface of pegs and bars."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Collider, Solver

OFFSET, OFFSET_SOURCE = "hanger_offset", "tip of the peg (nearest point of the bar) minus position, design"
DISTANCE, DISTANCE_SOURCE = "hanger_distance", "d_v, eq. 42: distance from the surface of peg or bar"
"""Names of the channels of a hanger, and what they are."""
HANGER_AXIS = Channel("hanger_axis", "vector", "", "unit vector out of the peg's tip (along the bar), design")
SEAT = Channel("seat", "scalar", "", "1 on the boundary of the hole (of the disc that comes onto the bar), design")
SEAT_OFFSET = Channel("seat_offset", "vector", "m", "hanger_offset of the middle of the seat, design")
SEAT_NORMAL = Channel("seat_normal", "vector", "", "unit normal of the seat, of its two the one along a peg or up, design")
SEAT_DEPTH = Channel("seat_depth", "scalar", "m", "how far the middle of the seat has come down the hanger, design")

WAITING_DISTANCE = 0.08
"""How far before a hanger [m] the way onto it begins."""
FUNNEL_RADIUS = 0.06
"""Distance from the way onto a hanger [m] from which it is entered at its beginning."""


@dataclass(frozen=True)
class Hanging:
    """How a cloth hangs on its hanger, in B worlds."""

    offset: torch.Tensor
    """From the middle of the seat to the hanger, (B, 3) [m]."""
    normal: torch.Tensor
    """Normal of the seat, of its two the one along a peg, or up above a bar, unit vectors (B, 3)."""
    depth: torch.Tensor
    """How far the middle of the seat has come down the hanger, negative before it, (B,) [m]."""
    way: torch.Tensor
    """How far the middle of the seat has to go before it comes onto the hanger, 0 on it, (B,) [m]."""
    alignment: torch.Tensor
    """How well the cloth is turned, in [0, 1], (B,)."""
    progress: torch.Tensor
    """How much of the hanging is done, from the last 8 cm before the hanger on, in [0, 1], (B,)."""
    is_on: torch.Tensor
    """Whether the seat is on the hanger, (B,) bool."""
    is_hung: torch.Tensor
    """Whether all of it is, (B,) bool."""
    measures: dict[str, torch.Tensor]
    """What decides about it, for the records, each (B,)."""


class Hanger(ABC):
    """A rigid thing on which a part of the cloth, the seat, has to come.

    Its pose in a world is a point and a unit vector, its axis.

    Attributes:
        colliders: What the cloth touches, K of them.
        distances: Smallest and largest distance of its middle from the origin [m].
        radius: Half its thickness [m].
        channels: What observations call `offsets` and `distances_to`.
    """

    colliders: Sequence[Collider]
    distances: tuple[float, float]
    radius: float
    channels: tuple[Channel, Channel]

    def attach(self, solver: Solver) -> None:  # noqa: B027  (a peg needs to know nothing)
        """Learn what the cloths of a solver are made of, before the first measurement."""

    @abstractmethod
    def draw_axes(self, draws: torch.Tensor, share: float) -> torch.Tensor:
        """Return random axes (b, 3) from numbers in [-1, 1) (b, 2), from a share of all directions allowed."""

    @abstractmethod
    def place(self, middles: torch.Tensor, axes: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the point (b, 3) and the positions of the colliders (b, K, 3) [m] for a middle and an axis, each (b, 3)."""

    @abstractmethod
    def offsets(self, points: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """Return the way from points (B, n, 3) to the place where the seat comes onto the hanger, (B, n, 3) [m]."""

    @abstractmethod
    def distances_to(self, points: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> torch.Tensor:
        """Return the distance of points (B, n, 3) from its surface, without what holds it, (B, n) [m]."""

    @abstractmethod
    def measure(self, solver: Solver, loop: torch.Tensor, point: torch.Tensor, axis: torch.Tensor) -> Hanging:
        """Measure how the cloth of every world hangs, with the boundary of its seat (B, L, 3) [m]."""


def distances_to_segment(points: torch.Tensor, start: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """Return the distances of points (B, n, 3) from the segment start ... start + step, each (B, 3), as (B, n) [m]."""
    offset = points - start[:, None]
    length2 = (step * step).sum(-1, keepdim=True)
    fraction = ((offset * step[:, None]).sum(-1) / length2).clamp(0.0, 1.0)
    return torch.linalg.vector_norm(offset - fraction[..., None] * step[:, None], dim=-1)


def facing(vectors: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Return vectors (B, 3), turned round where they point away from directions (B, 3)."""
    return torch.where((vectors * directions).sum(-1, keepdim=True) < 0.0, -vectors, vectors)


def way_to_go(height: torch.Tensor, aside: torch.Tensor) -> torch.Tensor:
    """Return how far a point is from the way onto a hanger, (B,) [m].

    The way is the last 8 cm before the hanger. It may be joined later the closer one is to it, like a funnel; from beside the
    hanger, where there is none, one has to come back to its beginning. On the way itself the rest of it is still to go.

    Args:
        height: Height before the hanger, negative behind it, (B,) [m].
        aside: Distance from the line on which the way lies, (B,) [m].
    """
    lowest = WAITING_DISTANCE * (aside / FUNNEL_RADIUS).clamp(max=1.0)
    return torch.sqrt(aside**2 + (height - lowest) ** 2)


def progress_of(offset: torch.Tensor, is_on: torch.Tensor, done: torch.Tensor) -> torch.Tensor:
    """Return how much of the hanging is done, (B,): half of it are the last 8 cm before the hanger.

    Args:
        offset: Way from the seat to the hanger, (B, 3) [m].
        is_on: Whether the seat is on the hanger, (B,) bool.
        done: How much of the rest is done once it is, in [0, 1], (B,).
    """
    left = torch.linalg.vector_norm(offset, dim=-1) / WAITING_DISTANCE
    return 0.5 * torch.where(is_on, 1.0 + done, (1.0 - left).clamp(min=0.0))
