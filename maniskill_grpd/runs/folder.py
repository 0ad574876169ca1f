"""Where runs lie. Imports no simulator, so that a run can be named without one."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from maniskill_grpd.runs.file_lock import try_lock

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


@contextlib.contextmanager
def hold_run(run_dir: Path) -> Iterator[None]:
    """Keep other processes away from a run; the lock ends with the process that holds it, however that ends.

    Raises:
        RunInUseError: If another process works at the run.
    """
    run_dir.mkdir(parents=True, exist_ok=True)
    with (run_dir / ".lock").open("w") as file:
        if not try_lock(file.fileno()):
            raise RunInUseError(f"another process works at {run_dir}; wait for it, stop it, or choose another --exp_name")
        yield


class RunInUseError(ValueError):
    """Two processes are asked to work at one run."""
