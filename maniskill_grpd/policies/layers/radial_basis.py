"""Functions of distance in which kernels are expanded."""

from __future__ import annotations

import torch
from torch import nn

_HALF_WAY = 0.3
"""Distance, in cutoff lengths, that the compressed coordinate maps to one half."""


class RadialBasis(nn.Module):
    r"""Smooth basis over all distances, with most resolution below one cutoff length.

        t = d / (d + 0.3),  d = distance / cutoff
        phi_0 = 1,  phi_b = exp(-((t - c_b) (B - 1))^2),  c_b evenly spaced in [0, 1]

    The compressed coordinate t in [0, 1) never leaves the range of the centres, so no distance is
    out of reach; with phi_0 every sender has a share in every receiver (eq. 11, 47).

    Shapes: distance (...) -> (..., B) as a list of B tensors (...).
    Symmetry: invariant, a function of distance alone.

    Args:
        num_basis: B, at least 1.
        cutoff: Unit of distance [m].
    """

    def __init__(self, num_basis: int, cutoff: float) -> None:
        super().__init__()
        if num_basis < 1:
            raise ValueError(f"num_basis must be at least 1, got {num_basis}")
        self.num_basis = num_basis
        self.cutoff = cutoff
        count = num_basis - 1
        self.centers = [i / max(count - 1, 1) for i in range(count)]

    def forward(self, distance: torch.Tensor) -> list[torch.Tensor]:
        """Values phi_0 ... phi_{B-1} at distances [m]."""
        scaled = distance / self.cutoff
        compressed = scaled / (scaled + _HALF_WAY)
        sharpness = float(self.num_basis - 1)
        bumps = [torch.exp(-((compressed - c) * sharpness).square()) for c in self.centers]
        return [torch.ones_like(distance), *bumps]

    def extra_repr(self) -> str:
        """Show the arguments when printed."""
        return f"num_basis={self.num_basis}, cutoff={self.cutoff:g} m"
