"""A training that is asked to stop: it ends between two iterations, with a checkpoint."""

from __future__ import annotations

from pathlib import Path


class TrainingStoppedError(Exception):
    """A training ended before its last iteration, because it was asked to.

    Args:
        run_dir: Folder of the run.
        iteration: Finished iterations.
        num_iterations: Those of the whole run.
        is_saved: Whether there is a checkpoint of the last one.
    """

    def __init__(self, run_dir: Path, iteration: int, num_iterations: int, *, is_saved: bool) -> None:
        self.run_dir = run_dir
        self.is_saved = is_saved
        where = f"; checkpoint {run_dir / 'last.pt'}" if is_saved else " without a checkpoint"
        super().__init__(f"stopped after {iteration} of {num_iterations} iterations{where}")


def never() -> bool:
    """Say that nobody asked to stop."""
    return False
