"""Links of arms as the object meets them: capsules that move while a control step lasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
import warp as wp

from maniskill_grpd.physics.kernels.data import Links

MOST_LINKS = 31
"""Links that a world can have: each is a bit of a number."""


@dataclass(frozen=True)
class Link:
    """A capsule that moves with the arm of a gripper."""

    gripper: int
    """Whose arm it belongs to: what this gripper holds lies between its fingers, and does not touch it there."""
    radius: float
    """[m]."""

    def __post_init__(self) -> None:
        if not 0.0 < self.radius < float("inf"):
            raise ValueError(f"the radius of a link must be finite and > 0 m, got {self.radius}")


class LinkMotions:
    """Where the links of all worlds are.

    Attributes:
        starts, ends: Both ends of their axes before and after the next control step, (B, L, 2, 3) [m]. In between they move in
            straight lines. Whoever moves the arms writes both before every step.
        data: What the kernel gets.
    """

    def __init__(self, links: Sequence[Link], num_worlds: int, num_groups: int, num_nodes: int, device: torch.device) -> None:
        """Put all links far away.

        Raises:
            ValueError: If there are too many.
        """
        if len(links) > MOST_LINKS:
            raise ValueError(f"a world can have at most {MOST_LINKS} links, got {len(links)}")
        count = max(len(links), 1)
        self.starts, self.ends = (torch.full((num_worlds, count, 2, 3), 1.0e3, device=device) for _ in range(2))
        self.data = Links()
        self.data.owners = wp.array([link.gripper for link in links], dtype=int, device=str(device))
        self.data.radii = wp.array([link.radius for link in links], dtype=float, device=str(device))
        for name in ("starts", "ends"):
            setattr(self.data, name, wp.from_torch(getattr(self, name).view(num_worlds, 2 * count, 3), dtype=wp.vec3))
        width = num_nodes if links else 1
        for name, rows in (("near", num_worlds), ("pinched", num_worlds), ("near_any", num_groups)):
            setattr(self.data, name, wp.zeros((rows, width), dtype=int, device=str(device)))
