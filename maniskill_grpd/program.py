"""The name of the program, for all who mention or start one of its commands. Below everything: imports nothing of the package."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable

PROGRAM = "maniskill-grpd"
"""What the program is called on a command line."""


def command_line(words: Iterable[str]) -> str:
    """Return what a person types for a command.

    Args:
        words: Name of the command and its options.
    """
    return shlex.join([PROGRAM, *words])


def process_arguments(words: Iterable[str], num_processes: int = 1) -> list[str]:
    """Return the arguments of a process that runs a command, with the interpreter of this one.

    Args:
        words: Name of the command and its options.
        num_processes: Processes that work at it together, through PyTorch's launcher.
    """
    module = ["-m", "maniskill_grpd", *words]
    if num_processes == 1:
        return [sys.executable, *module]
    return [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc_per_node={num_processes}", *module]
