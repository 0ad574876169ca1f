"""Where the numbers of a run go: metrics.jsonl, TensorBoard and, if asked, Weights & Biases."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from torch.utils.tensorboard import SummaryWriter

from maniskill_grpd.extras import import_extra
from maniskill_grpd.learning.config import TrainConfig

ROW_KEYS = {"kind", "iteration", "global_step"}
"""What every row of metrics.jsonl has, beside its metrics."""


class RunLog:
    """Writes each row of metrics to every destination.

    Args:
        run_dir: Folder of the run, which must exist.
        config: Options of the run.
        resumed_iteration: Rows of later iterations are dropped: they were written after the
            checkpoint that is resumed, and will be written again. 0 starts afresh.

    Raises:
        RuntimeError: If `config.track` is set and wandb is not installed.
    """

    def __init__(self, run_dir: Path, config: TrainConfig, resumed_iteration: int = 0) -> None:
        self._wandb = _start_wandb(run_dir, config) if config.track else None
        self._path = run_dir / "metrics.jsonl"
        last_step = truncate_rows(self._path, resumed_iteration)
        self._file = self._path.open("a", encoding="utf-8")
        self._writer = SummaryWriter(str(run_dir), purge_step=last_step + 1 if last_step else None)
        if not resumed_iteration:
            self._writer.add_text("hyperparameters", _markdown_table(config.to_dict()))

    def add(self, kind: str, iteration: int, global_step: int, metrics: dict[str, float]) -> None:
        """Write one row.

        Args:
            kind: "train" or "eval".
            iteration: Finished iterations.
            global_step: Environment steps taken, the abscissa of every plot.
            metrics: Values by tag, such as "train/return".
        """
        row = {"kind": kind, "iteration": iteration, "global_step": global_step, **metrics}
        self._file.write(json.dumps(row) + "\n")
        self._file.flush()
        for tag, value in metrics.items():
            self._writer.add_scalar(tag, value, global_step)
        if self._wandb is not None:
            self._wandb.log(metrics, step=global_step)

    def close(self) -> None:
        """Finish writing."""
        self._file.close()
        self._writer.close()
        if self._wandb is not None:
            self._wandb.finish()


def read_rows(path: Path, kind: str | None = None) -> list[dict[str, Any]]:
    """Read metrics.jsonl; a last line that a crash cut short is left out.

    Args:
        path: The file; a missing one has no rows.
        kind: Only rows of this kind.

    Raises:
        DamagedLogError: Naming file and line, if one is no row.
    """
    if not path.exists():
        return []
    rows, damaged = _parse_rows(path)
    if damaged:
        raise DamagedLogError(f"{path}, line {damaged[0]}: damaged, no row of metrics; move the file away")
    return [row for row in rows if kind is None or row["kind"] == kind]


class DamagedLogError(ValueError):
    """A line of metrics.jsonl is no row."""


def truncate_rows(path: Path, iteration: int) -> int:
    """Drop the rows of iterations after `iteration` and return the last step that is kept.

    A run goes on from its checkpoint whatever happened to its log: a damaged one is kept aside, and said to be.
    """
    rows, damaged = _parse_rows(path) if iteration and path.exists() else ([], [])
    if damaged:
        aside = path.with_name(f"damaged_{path.name}")
        path.replace(aside)
        print(f"{path}, line {damaged[0]}: damaged; {len(damaged)} line(s) left out, the old file is {aside}", file=sys.stderr)
    kept = [row for row in rows if row["iteration"] <= iteration]
    temporary = path.with_name(f".{path.name}.tmp")
    temporary.write_text("".join(json.dumps(row) + "\n" for row in kept), encoding="utf-8")
    temporary.replace(path)
    return kept[-1]["global_step"] if kept else 0


def _parse_rows(path: Path) -> tuple[list[dict[str, Any]], list[int]]:
    """Return the rows of a log, and the numbers of the lines that are none, without a last one that was cut short."""
    rows, damaged = [], []
    # Bytes that are no text end up in a line that is no JSON, or in a value that is no number.
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            row = None
        if isinstance(row, dict) and row.keys() >= ROW_KEYS:
            rows.append(row)
        elif row is not None or number < len(lines):
            damaged.append(number)
    return rows, damaged


def _start_wandb(run_dir: Path, config: TrainConfig) -> Any:
    wandb = import_extra("wandb", "track", "--track")
    return wandb.init(
        project=config.wandb_project_name,
        entity=config.wandb_entity,
        group=config.wandb_group,
        name=run_dir.name,
        id=run_dir.name,
        resume="allow",
        config=config.to_dict(),
        tags=[config.algorithm, config.policy],
        sync_tensorboard=False,
        dir=str(run_dir),
    )


def _markdown_table(fields: dict[str, Any]) -> str:
    return "|param|value|\n|-|-|\n" + "\n".join(f"|{k}|{v}|" for k, v in fields.items())
