"""The processor that figures were measured on."""

from __future__ import annotations

import platform
from pathlib import Path

import torch


def processor_name() -> str:
    """Return the processor's name and the vector instructions PyTorch uses on it, on which speed and rounding depend."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text(encoding="utf-8").splitlines() if info.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()} ({torch.backends.cpu.get_cpu_capability()})"
