"""The record of how a run was made: options, versions, commit, machine."""

from __future__ import annotations

import json
import platform
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import torch

import maniskill_grpd
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.processor import processor_name
from maniskill_grpd.runs.folder import check_name
from maniskill_grpd.runs.versions import package_versions
from maniskill_grpd.tasks.measurement import Metric


class Recordable(Protocol):
    """Options that a record can hold."""

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain types."""


def make_run_name(config: TrainConfig) -> str:
    """Return `exp_name`, or a name that tells task, policy, algorithm, seed and time.

    Raises:
        ValueError: If `exp_name` leads out of the folder of all runs.
    """
    if config.exp_name is not None:
        return check_name(config.exp_name)
    return f"{config.env_id}__{config.policy}_{config.algorithm}__{config.seed}__{int(time.time())}"


def write_run_record(
    run_dir: Path, config: Recordable, device: torch.device, task: Mapping[str, Any], num_processes: int = 1
) -> None:
    """Write config.json: options, versions, commit, machine; enough to make the run again.

    Args:
        run_dir: Folder of the run; made where it is missing.
        config: Options of the run.
        device: Where the policy is trained.
        task: What `describe_task` or `describe_training` says.
        num_processes: Processes that train together.
    """
    path = run_dir / "config.json"
    record = {
        "config": config.to_dict(),
        "command": sys.argv,
        "num_processes": num_processes,
        **task,
        "earlier_fingerprints": _earlier_fingerprints(path, task["fingerprint"]),
        "device": str(device),
        "device_name": torch.cuda.get_device_name(device) if device.type == "cuda" else processor_name(),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "versions": {"maniskill_grpd": maniskill_grpd.__version__, **package_versions()},
        "git": _git_state(),
    }
    run_dir.mkdir(parents=True, exist_ok=True)
    write_aside(path, json.dumps(record, indent=2) + "\n")


def _earlier_fingerprints(path: Path, fingerprint: Mapping[str, str]) -> list[Mapping[str, str]]:
    """Return the other fingerprints of the code that wrote this record before: a run that goes on may go on with other code."""
    if not path.exists():
        return []
    try:
        record = _read_record(path)
    except ValueError:  # a run goes on from its checkpoint even where its record is damaged
        return []
    found = [*record.get("earlier_fingerprints", []), record.get("fingerprint")]
    return [earlier for earlier in found if earlier not in (None, fingerprint)]


def write_aside(path: Path, text: str) -> None:
    """Write a file so that it is at every moment either the old or the new one.

    Raises:
        OSError: If it cannot be written, because the disk is full for example; what was there before is untouched.
    """
    temporary = path.with_name(f".{path.name}.tmp")
    try:
        temporary.write_text(text, encoding="utf-8")
        temporary.replace(path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise


def read_run_config(run_dir: Path) -> TrainConfig:
    """Read the options of a run back from its config.json.

    Args:
        run_dir: Folder of the run.

    Raises:
        FileNotFoundError: If the folder is not one of a run.
        ValueError: If the record is damaged, naming file and line.
    """
    path = run_dir / "config.json"
    if not path.is_file():
        raise FileNotFoundError(f"{run_dir} is not the folder of a run: it has no config.json")
    try:
        return TrainConfig.from_dict(_read_record(path)["config"])
    except TypeError as error:
        raise ValueError(f"{path}: damaged, {error}") from error


def read_progress(run_dir: Path) -> Metric | None:
    """Return what measures the progress of a run, None where there is no record of it."""
    path = run_dir / "config.json"
    if not path.is_file():
        return None
    found = _read_record(path).get("progress")
    return None if found is None else Metric(**found)


def _read_record(path: Path) -> dict[str, Any]:
    """Read config.json; a ValueError names file and line where it is damaged."""
    try:
        # Bytes that are no text end up where the parser finds them.
        record = json.loads(path.read_text(encoding="utf-8", errors="replace"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}, line {error.lineno}: damaged, {error.msg}") from error
    if not isinstance(record, dict) or not isinstance(record.get("config"), dict):
        raise ValueError(f"{path}: not the record of a run, it has no entry 'config'")
    return record


def _git_state() -> dict[str, Any] | None:
    """Return commit and whether files differ from it; None outside a git checkout."""
    folder = Path(__file__).parent
    try:
        commit = _git(folder, "rev-parse", "HEAD")
        return {"commit": commit, "dirty": bool(_git(folder, "status", "--porcelain"))}
    except (OSError, subprocess.CalledProcessError):
        return None


def _git(folder: Path, *arguments: str) -> str:
    command = ["git", "-C", str(folder), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()
