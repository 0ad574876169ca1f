"""Choices among a number of possibilities."""

from __future__ import annotations

import torch


def as_choice(draws: torch.Tensor, num: int | torch.Tensor) -> torch.Tensor:
    """Turn numbers that are uniform in [-1, 1) into equally likely ones of 0 ... num - 1, (b,) int64.

    Args:
        draws: (b,).
        num: Number of possibilities, the same for all or (b,) int64.
    """
    share = (draws + 1.0) / 2.0
    return torch.clamp((share * num).long(), max=num - 1)  # float32 rounds the largest draws up to 1
