"""Train GRPD with BPP on RopeShaping-v1 for a few minutes and show what it learned; what `make demo` runs.

Writes runs/demo/: learning_curve.png, policy.mp4 (or .gif), metrics.json, final_ckpt.pt.
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.runs.demo import DemoConfig, demonstrate


def show(config: DemoConfig) -> None:
    """Run the demonstration."""
    demonstrate(config)


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(show, DemoConfig, arguments)
