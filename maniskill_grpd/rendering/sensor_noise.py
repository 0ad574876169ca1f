"""What real sensors do to exact images, in random numbers that depend on the seed of each world alone."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import torch
import warp as wp

from maniskill_grpd.physics.launches import quiet_warp
from maniskill_grpd.rendering.kernels.sensor import measure_depth, write_normal, write_uniform
from maniskill_grpd.rendering.streams import warp_stream


@dataclass(frozen=True, kw_only=True)
class DepthSensor:
    """Errors of a camera that finds depth by triangulation: what it measures is the disparity, proportional to 1 / depth.

    Noise and steps are those of the inverse depth [1/m]: at a depth z [m] they are z^2 times as large, in metres. A step of 0.001
    per metre rounds to 1 mm at 1 m and to 4 mm at 2 m.

    Raises:
        ValueError: If a value is negative or not finite, or the dropout is not below 1.
    """

    noise: float = 0.0
    """Standard deviation of the inverse depth [1/m]."""
    step: float = 0.0
    """What the inverse depth is rounded to multiples of [1/m]; 0: not at all."""
    dropout: float = 0.0
    """Share of pixels, drawn anew for each image, that find nothing."""

    def __post_init__(self) -> None:
        for name, limit in (("noise", math.inf), ("step", math.inf), ("dropout", 1.0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < limit:
                raise ValueError(f"{name} of a depth sensor must be in [0, {limit:g}), got {value!r}")

    @classmethod
    def from_mapping(cls, settings: Mapping[str, float] | None) -> DepthSensor | None:
        """Return the sensor with some settings by name, None where none are given.

        Raises:
            ValueError: If there is no such setting, listing those there are.
        """
        if settings is None:
            return None
        known = [field.name for field in fields(cls)]
        if not isinstance(settings, Mapping) or set(settings) - set(known):
            raise ValueError(f"depth_sensor must be a mapping with any of {known}, got {settings!r}")
        return cls(**settings)

    def measure(self, depth: torch.Tensor, seeds: torch.Tensor) -> torch.Tensor:
        """Return what the sensor says of exact depths.

        Args:
            depth: (B, H, W) float32 [m]; 0 for nothing.
            seeds: (B,) int32; the same seed gives the same errors.

        Returns:
            (B, H, W) [m]; 0 where nothing is found.
        """
        exact = depth.flatten(1).contiguous()
        measured = torch.empty_like(exact)
        errors = [wp.from_torch(seeds), self.noise, self.step, self.dropout]
        _launch(measure_depth, exact, [wp.from_torch(exact), *errors, wp.from_torch(measured)])
        return measured.view_as(depth)


def draw_normal(seeds: torch.Tensor, *shape: int) -> torch.Tensor:
    """Return normally distributed numbers (B, *shape), those of each world from its seed (B,) int32 alone."""
    return _draw(write_normal, seeds, shape)


def draw_uniform(seeds: torch.Tensor, *shape: int) -> torch.Tensor:
    """Return numbers in [0, 1), (B, *shape), those of each world from its seed (B,) int32 alone."""
    return _draw(write_uniform, seeds, shape)


def _draw(kernel: wp.Kernel, seeds: torch.Tensor, shape: tuple[int, ...]) -> torch.Tensor:
    numbers = torch.empty(len(seeds), math.prod(shape), device=seeds.device)
    _launch(kernel, numbers, [wp.from_torch(seeds), wp.from_torch(numbers)])
    return numbers.view(len(seeds), *shape)


def _launch(kernel: wp.Kernel, like: torch.Tensor, inputs: list) -> None:
    with quiet_warp():
        wp.init()
        wp.launch(kernel, dim=tuple(like.shape), inputs=inputs, device=str(like.device), stream=warp_stream(like.device))
