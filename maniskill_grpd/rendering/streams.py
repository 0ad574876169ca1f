"""On which stream of a GPU Warp works."""

from __future__ import annotations

import torch
import warp as wp


def warp_stream(device: torch.device) -> wp.Stream | None:
    """Return PyTorch's current stream, so that both work in order; None on CPU."""
    return wp.stream_from_torch(torch.cuda.current_stream(device)) if device.type == "cuda" else None
