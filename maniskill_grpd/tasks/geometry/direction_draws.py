"""Uniform random directions and orientations from uniform numbers."""

from __future__ import annotations

import torch
from mani_skill.utils.geometry.rotation_conversions import quaternion_multiply


def directions_in_cap(draws: torch.Tensor, half_angle: float) -> torch.Tensor:
    """Return directions that are uniform on a cap of the unit sphere about z, by Archimedes' theorem.

    Args:
        draws: Uniform in [-1, 1), (b, 2).
        half_angle: Largest angle to z [rad]; pi is the whole sphere.

    Returns:
        Unit vectors, (b, 3).
    """
    lowest = torch.cos(torch.tensor(half_angle, dtype=draws.dtype, device=draws.device))
    z = 1.0 - (1.0 - lowest) * (draws[:, 0] + 1.0) / 2.0
    around = torch.pi * draws[:, 1]
    r = (1.0 - z * z).clamp(min=0.0).sqrt()
    return torch.stack([r * around.cos(), r * around.sin(), z], dim=-1)


def orientations_in_cap(draws: torch.Tensor, half_angle: float) -> torch.Tensor:
    """Return orientations: a turn about z by up to `half_angle`, then z tilted to a direction in the cap; (b, 4) (w, x, y, z).

    With `half_angle` pi they are uniform over all rotations (the direction of z is, and so is the turn about it).

    Args:
        draws: Uniform in [-1, 1), (b, 3).
        half_angle: Largest tilt and largest turn [rad].
    """
    turn = 0.5 * half_angle * draws[:, 2]
    zero = torch.zeros_like(turn)
    about_z = torch.stack([turn.cos(), zero, zero, turn.sin()], dim=-1)
    return quaternion_multiply(tilts_of_z(directions_in_cap(draws[:, :2], half_angle)), about_z)


def tilts_of_z(directions: torch.Tensor) -> torch.Tensor:
    """Return the smallest rotations that take z to unit vectors (b, 3), as quaternions (b, 4) (w, x, y, z)."""
    x, y, z = directions.unbind(-1)
    # Half the angle between z and -z is a right angle about any horizontal axis.
    opposite = torch.tensor([0.0, 1.0, 0.0, 0.0], dtype=directions.dtype, device=directions.device)
    tilt = torch.stack([1.0 + z, -y, x, torch.zeros_like(z)], dim=-1)
    tilt = torch.where((1.0 + z < 1e-6)[:, None], opposite, tilt)
    return torch.nn.functional.normalize(tilt, dim=-1)
