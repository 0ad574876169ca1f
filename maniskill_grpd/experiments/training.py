"""A training as a job runs it: what starts it or resumes it, and how far it is, as its folder tells."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from maniskill_grpd.experiments.records import read_json
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.config import NO_RECOMMENDED, RESUMABLE_FIELDS
from maniskill_grpd.learning.options import to_arguments
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.runs.folder import RUNS

MAY_DIFFER = (RESUMABLE_FIELDS - {"total_timesteps"}) | {"exp_name", "sim_backend"}
"""Options that a run in the folder may have otherwise than the training that is wanted."""

RECORD_FILES = ("config.json", "metrics.jsonl", "events.out.tfevents.*", "best_ckpt.pt")
"""What a run may have written before its first checkpoint; patterns of names."""


@dataclass(frozen=True)
class Training:
    """The command that trains a run.

    Attributes:
        config: Its options; `exp_name` says where it goes.
        num_processes: Processes that train it together.
    """

    config: TrainConfig
    num_processes: int = 1

    doing = "training"

    def __post_init__(self) -> None:
        name = Path(self.config.exp_name or "")
        if name.is_absolute() or ".." in name.parts or name == Path():
            raise ValueError(f"runs go to folders below {RUNS}/, got the name {self.config.exp_name!r}")

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return RUNS / self.config.exp_name

    @property
    def checkpoint(self) -> Path:
        """What a finished training leaves, unless it is to write no checkpoints."""
        return self.folder / "final_ckpt.pt"

    @property
    def total(self) -> int:
        """Environment steps of the whole training."""
        return self.config.total_timesteps

    @property
    def steps(self) -> int:
        """Environment steps trained so far."""
        return self.total if self.checkpoint.exists() else self._logged_steps()

    @property
    def words(self) -> list[str]:
        """The command that goes on with the training, or begins it if it has no checkpoint."""
        if (self.folder / "last.pt").exists():
            is_own = ":" in self.config.env_id  # whoever named its module to this sweep or study trusts it
            return ["train", "--resume", str(self.folder), *(["--allow_import"] if is_own else [])]
        return ["train", *to_arguments(self.config), NO_RECOMMENDED]

    def has_begun(self) -> bool:
        """Return whether the folder holds the run."""
        return (self.folder / "config.json").exists()

    def is_done(self) -> bool:
        """Return whether the training has come to its end; one without checkpoints tells it by its log."""
        if self.config.save_model:
            return self.checkpoint.exists()
        return self._logged_steps() >= self.config.num_iterations * self.config.batch_size

    def prepare(self) -> None:
        """Let a run that was interrupted before its first checkpoint begin anew: remove its record, and nothing else."""
        if not self.has_begun() or (self.folder / "last.pt").exists():
            return
        for pattern in RECORD_FILES:
            for path in self.folder.glob(pattern):
                path.unlink()

    def check(self) -> None:
        """Refuse a folder that holds something else than this run.

        Raises:
            ValueError: Naming the options that differ, or the files that no run has left.
        """
        if not self.has_begun():
            return
        wanted = self.config.to_dict()
        found = read_json(self.folder / "config.json").get("config")
        if not isinstance(found, dict):
            raise ValueError(f"{self.folder / 'config.json'} names no options of a training; move {self.folder} away")
        names = sorted(wanted.keys() & found.keys() - MAY_DIFFER)
        differences = [f"{name} was {found[name]}, is {wanted[name]}" for name in names if found[name] != wanted[name]]
        if differences:
            raise ValueError(f"{self.folder} was trained with other options ({'; '.join(differences)}); move it away")

    def _logged_steps(self) -> int:
        rows = read_rows(self.folder / "metrics.jsonl", "train")
        return rows[-1]["global_step"] if rows else 0
