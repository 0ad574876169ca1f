"""What a rasteriser draws: triangles in each of a batch of worlds."""

from __future__ import annotations

from dataclasses import dataclass

import torch

Color = tuple[float, float, float]


@dataclass(frozen=True)
class TriangleScene:
    """B worlds of V vertices, joined to triangles in M ways.

    Tensors are kept, not copied: write into them, and the next drawing shows it.

    Raises:
        ValueError: If a shape or dtype does not fit, or a triangle has a corner that there is not.
    """

    vertices: torch.Tensor
    """(B, V, 3) float32 [m] in the frame of each world; triangles of vertices that are not finite are left out."""
    triangles: torch.Tensor
    """Corners, counter-clockwise as seen from the front, (M, F, 3) int32; those with two equal corners are left out."""
    labels: torch.Tensor
    """What each triangle is part of, see `Label`, (M, F) int32."""
    variants: torch.Tensor
    """Which of the M ways each world takes, (B,) int32."""
    fronts: torch.Tensor | None = None
    """Colours of the triangles' fronts, (M, F, 3) float32 in [0, 1]; grey for None."""
    backs: torch.Tensor | None = None
    """Colours of their backs, (M, F, 3); those of the fronts for None."""

    def __post_init__(self) -> None:
        num, count = len(self.vertices), self.vertices.shape[1] if self.vertices.ndim == 3 else -1
        variants, faces = self.triangles.shape[:2] if self.triangles.ndim == 3 else (-1, -1)
        _expect("vertices", self.vertices, (num, count, 3), torch.float32)
        _expect("triangles", self.triangles, (variants, faces, 3), torch.int32)
        _expect("labels", self.labels, (variants, faces), torch.int32)
        _expect("variants", self.variants, (num,), torch.int32)
        for name in ("fronts", "backs"):
            if getattr(self, name) is not None:
                _expect(name, getattr(self, name), (variants, faces, 3), torch.float32)
        for name, indices, limit in (("triangles", self.triangles, count), ("variants", self.variants, variants)):
            if indices.numel() and not (int(indices.min()) >= 0 and int(indices.max()) < limit):
                raise ValueError(f"{name} must be in [0, {limit}), got {int(indices.min())} to {int(indices.max())}")

    @property
    def num_worlds(self) -> int:
        """Number of worlds B."""
        return len(self.vertices)

    @property
    def device(self) -> torch.device:
        """Where all tensors are."""
        return self.vertices.device


def _expect(name: str, tensor: torch.Tensor, shape: tuple[int, ...], dtype: torch.dtype) -> None:
    if tuple(tensor.shape) != shape or tensor.dtype != dtype or not tensor.is_contiguous():
        raise ValueError(f"{name} must be contiguous {shape} {dtype}, got {tuple(tensor.shape)} {tensor.dtype}")
