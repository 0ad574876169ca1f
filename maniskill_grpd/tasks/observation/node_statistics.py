"""Statistics over the nodes of objects that are padded to a common number of nodes."""

from __future__ import annotations

import torch


def mean_over_nodes(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return the mean of values (B, N) over the nodes that count, (B,); 0 where none does.

    Args:
        values: (B, N), finite also where they do not count.
        mask: Nodes that count, (B, N) bool.
    """
    return (values * mask).sum(dim=1) / mask.sum(dim=1).clamp(min=1)


def max_over_nodes(values: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return the largest of values (B, N) >= 0 over the nodes that count, (B,); 0 where none does."""
    return (values * mask).amax(dim=1)
