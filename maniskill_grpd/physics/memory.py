"""Memory is asked for before it is taken: a machine that runs out of it hangs, or ends the process without a word."""

from __future__ import annotations

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
    if device.type == "cuda":
        available = torch.cuda.mem_get_info(device)[0]
    else:
        available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    if num_bytes > available:
        raise ValueError(
            f"{whose} need {num_bytes / 2**30:.1f} GiB for {purpose} alone, {device} has {available / 2**30:.1f} GiB"
        )
