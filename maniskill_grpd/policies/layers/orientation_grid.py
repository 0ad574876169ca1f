"""Directions that features are functions of."""

from __future__ import annotations

import math

import torch

PER_RING = 4
"""Directions at one height; neighbouring rings are turned by half a step."""


def orientation_grid(num_directions: int) -> torch.Tensor:
    """Spread unit vectors over the sphere in rings of four, at heights that cut it into bands of equal area.

    A quarter turn about z maps the grid onto itself.

    Args:
        num_directions: A multiple of 4.

    Returns:
        (num_directions, 3), float32.

    Raises:
        ValueError: If the number is no positive multiple of 4.
    """
    if num_directions < PER_RING or num_directions % PER_RING:
        raise ValueError(f"num_directions must be a positive multiple of {PER_RING}, got {num_directions}")
    num_rings = num_directions // PER_RING
    ring = torch.arange(num_rings, dtype=torch.float64).repeat_interleave(PER_RING)
    height = (2.0 * ring + 1.0) / num_rings - 1.0
    step = 2.0 * math.pi / PER_RING
    angle = step * (torch.arange(PER_RING, dtype=torch.float64).repeat(num_rings) + 0.5 * (ring % 2))
    radius = (1.0 - height.square()).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), height], dim=-1).float()
