"""Pinhole cameras in the form of ManiSkill: OpenCV intrinsics and extrinsics, and poses that look along x."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

MAX_SIDE = 4096
"""Largest height and width of an image [pixels]."""

LOOKING_ALONG_X = ((0.0, -1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0))
"""Turns the frame of a pose (x forward, y left, z up) into that of a camera (x right, y down, z forward)."""


@dataclass(frozen=True)
class Lens:
    """What cameras have in common: the size of their images and how far they see.

    Raises:
        ValueError: If a size is not in 1 ... 4096, or not 0 < near < far.
    """

    width: int
    """[pixels]"""
    height: int
    """[pixels]"""
    near: float = 0.01
    """What is nearer is not seen [m], along the axis of the camera."""
    far: float = 100.0
    """What is farther is not seen [m]."""

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            side = getattr(self, name)
            if not (isinstance(side, int) and 1 <= side <= MAX_SIDE):
                raise ValueError(f"{name} must be a whole number in 1 ... {MAX_SIDE} pixels, got {side!r}")
        if not 0.0 < self.near < self.far < math.inf:
            raise ValueError(f"near and far must be 0 < near < far < infinity [m], got {self.near} and {self.far}")


def intrinsic_from_fov(fov: float, width: int, height: int) -> torch.Tensor:
    """Return the matrix of a camera with square pixels and a vertical field of view [rad], (3, 3) [pixels].

    Raises:
        ValueError: If the field of view is not between 0 and pi.
    """
    if not 0.0 < fov < math.pi:
        raise ValueError(f"the field of view must be between 0 and pi rad, got {fov}")
    focal = height / 2.0 / math.tan(fov / 2.0)
    return torch.tensor([[focal, 0.0, width / 2.0], [0.0, focal, height / 2.0], [0.0, 0.0, 1.0]])


def extrinsic_from_pose(pose: torch.Tensor) -> torch.Tensor:
    """Return the extrinsics x_camera = R x_world + t, (..., 3, 4), of cameras that look along x of their poses (..., 4, 4)."""
    turn = torch.tensor(LOOKING_ALONG_X, dtype=pose.dtype, device=pose.device)
    rotation = turn @ pose[..., :3, :3].transpose(-1, -2)
    return torch.cat([rotation, -rotation @ pose[..., :3, 3:]], dim=-1)


def look_at(position: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Return the extrinsics (..., 3, 4) of cameras at positions (..., 3) that look at targets (..., 3) [m], with z up.

    One that looks straight up or down has the y-axis of the world up in its image.
    """
    forward = torch.nn.functional.normalize(target - position, dim=-1)
    is_upright = forward[..., 2:].abs() > 1.0 - 1e-6
    up = torch.where(is_upright, forward.new_tensor([0.0, 1.0, 0.0]), forward.new_tensor([0.0, 0.0, 1.0]))
    right = torch.nn.functional.normalize(torch.linalg.cross(forward, up), dim=-1)
    rotation = torch.stack([right, torch.linalg.cross(forward, right), forward], dim=-2)
    return torch.cat([rotation, -(rotation @ position[..., None])], dim=-1)
