"""Measure what policies look at, and write a page with pictures.

maniskill-grpd interpret --checkpoint checkpoints/cloth_folding.pt checkpoints/cloth_hanging.pt --output docs/results

Sensitivity of each gripper to corners, held nodes, the line of a fold and the nodes near it, and how alike the features of such
nodes are, beside the same network without training. `inspect` draws a single episode.
"""

from __future__ import annotations

from collections.abc import Sequence

from maniskill_grpd.commands.run_command import run_command
from maniskill_grpd.runs.interpretation_page import InterpretationConfig, write_interpretation


def interpret(config: InterpretationConfig) -> None:
    """Write the page, and say where it is."""
    print(f"page: {write_interpretation(config)}")


def main(arguments: Sequence[str]) -> int:
    """Run the command."""
    return run_command(interpret, InterpretationConfig, arguments)
