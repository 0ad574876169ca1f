"""The options with which a run goes on."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

from maniskill_grpd.learning import TrainConfig, load_checkpoint
from maniskill_grpd.learning.checkpoint import reading
from maniskill_grpd.runs.record import read_run_config
from maniskill_grpd.tasks.options.env_id import check_env_id


def resumed_options(run_dir: Path, *, allow_import: bool = False) -> TrainConfig:
    """Return the options of a run: from its record, or from its checkpoint where the record is damaged or lost.

    Args:
        run_dir: Folder of the run.
        allow_import: Whether the id of its task may name a module, which is imported when the task is made.

    Raises:
        FileNotFoundError: If the folder is not one of a run.
        ValueError: If the record is damaged and there is no checkpoint; if the id of its task names a module and that is not
            allowed.
        CheckpointError: If both are damaged.
    """
    last = run_dir / "last.pt"
    try:
        config = read_run_config(run_dir)
    except (ValueError, FileNotFoundError) as error:
        if not last.exists():
            raise
        print(f"{error}; the options are those of {last}", file=sys.stderr)
        contents = load_checkpoint(last)
        with reading(last, "train_config"):
            config = TrainConfig.from_dict(contents["train_config"])
    check_env_id(config.env_id, str(run_dir), allow_import=allow_import)
    # The weights that the run began with are those of its own checkpoint by now.
    return dataclasses.replace(config, resume=None, checkpoint=None if last.exists() else config.checkpoint)
