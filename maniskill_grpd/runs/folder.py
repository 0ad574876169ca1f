"""Where runs lie. Imports nothing of the package, so that a run can be named without the simulator."""

from pathlib import Path

RUNS = Path("runs")
"""Folder of all runs, below the present one."""


def check_name(name: str) -> str:
    """Return the name of a run, which may have folders in it.

    Raises:
        ValueError: If it leads out of the folder of all runs.
    """
    if not name or Path(name).is_absolute() or ".." in Path(name).parts or Path(name) == Path():
        raise ValueError(f"exp_name must name a folder below {RUNS}/, without '..', got {name!r}")
    return name
