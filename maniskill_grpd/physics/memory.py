"""Memory is asked for before it is taken: a machine that runs out of it hangs, or ends the process without a word."""

from __future__ import annotations

import math
import os

import torch


def check_memory(whose: str, num_bytes: int, purpose: str, device: torch.device) -> None:
    """Refuse what does not fit into all the memory of the CPU, or into what is free on a GPU.

    Args:
        whose: What needs it, such as "64 worlds".
        num_bytes: What it needs.
        purpose: For what.
        device: Where.

    Raises:
        ValueError: With what is needed and what there is.
    """
    available = torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else _main_memory()
    if num_bytes > available:
        raise ValueError(
            f"{whose} need {num_bytes / 2**30:.1f} GiB for {purpose} alone, {device} has {available / 2**30:.1f} GiB"
        )


def _main_memory() -> float:
    """Return the memory of the machine in bytes; infinity on Windows, which does not tell it this way."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else math.inf
