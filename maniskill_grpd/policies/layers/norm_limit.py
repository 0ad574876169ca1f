"""Bounds on the length of actions."""

from __future__ import annotations

import torch

LARGEST_LENGTH = 1.2
"""Limit of the length of a bounded mean action, in units of the largest displacement: full speed lies inside."""
_FLOOR = 1e-6
"""Stabiliser of the norm, whose gradient at zero is undefined."""


def limit_norm(vectors: torch.Tensor) -> torch.Tensor:
    r"""Shorten vectors smoothly below 1.2: v tanh(|v| / 1.2) 1.2 / |v|; short ones hardly change.

    Shapes: (..., 3) -> (..., 3).
    Symmetry: equivariant under O(3).

    Args:
        vectors: v.
    """
    norm = (vectors.square().sum(-1, keepdim=True) + _FLOOR**2).sqrt()
    return vectors * (LARGEST_LENGTH * torch.tanh(norm / LARGEST_LENGTH) / norm)
