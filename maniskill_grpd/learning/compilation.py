"""Compiled passes of a policy."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable
from typing import Any

import torch


def compiled(evaluate: Callable[..., Any], device: torch.device) -> Callable[..., Any]:
    """Return what evaluates prepared graphs, compiled for each shape that it meets.

    PyTorch keeps what it compiled on disk (`TORCHINDUCTOR_CACHE_DIR`), so that only the first run with a network and a chunk
    size waits for the compiler.

    Args:
        evaluate: `Policy.evaluate`.
        device: Where the policy is.

    Raises:
        ValueError: If the code for a CPU would need a C++ compiler that is not there.
    """
    compiler = os.environ.get("CXX") or ("clang++" if sys.platform == "darwin" else "g++")
    if device.type == "cpu" and shutil.which(compiler) is None:
        raise ValueError(
            f"--compile needs the C++ compiler {compiler}, which is not installed: install it, or leave --compile out"
        )
    return torch.compile(evaluate, dynamic=False)
