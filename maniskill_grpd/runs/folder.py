"""Where runs lie. Imports nothing of the package, so that a run can be named without the simulator."""

from pathlib import Path

RUNS = Path("runs")
"""Folder of all runs, below the present one."""
