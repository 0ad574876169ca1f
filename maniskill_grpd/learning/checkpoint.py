"""Checkpoints: one file, written atomically, read without executing anything in it."""

from __future__ import annotations

import io
import os
import pickle
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch

FORMAT = "maniskill_grpd.checkpoint"
VERSION = 2

_KEYS = {
    "policy": "what rebuilds the policy: its `config`, plain types",
    "weights": "state_dict of the policy, normaliser included",
    "optimizer": "state_dict of the optimizer",
    "algorithm": "state of the algorithm itself, such as multipliers",
    "value_scale": "statistics of the returns",
    "generators": "states of the random generators",
    "train_config": "TrainConfig.to_dict()",
    "iteration": "finished iterations",
    "global_step": "environment steps taken",
    "best_score": "[best_metric, return] of best_ckpt.pt, None before the first evaluation",
}


_TYPES: dict[str, type | tuple[type, ...]] = {
    **dict.fromkeys(("policy", "weights", "optimizer", "algorithm", "value_scale", "generators", "train_config"), dict),
    "iteration": int,
    "global_step": int,
    "best_score": (list, type(None)),
}

_MISFITS = (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError)
"""What is raised where an entry of a checkpoint is not what its reader expects."""

_UNREADABLE = (RuntimeError, OSError, EOFError, ValueError, pickle.UnpicklingError, zipfile.BadZipFile)
"""What torch.load raises for files that are cut short or are something else."""


class CheckpointError(RuntimeError):
    """A file is not a usable checkpoint; the message says why and what to do."""


def save_checkpoint(path: str | os.PathLike[str], contents: dict[str, Any]) -> None:
    """Write a checkpoint so that the file is at every moment either the old or the new one.

    Args:
        path: File to write; its folder must exist.
        contents: The entries of a checkpoint (see `load_checkpoint`), tensors and plain types only.

    Raises:
        ValueError: If entries are missing or unknown.
        OSError: If the file cannot be written, because the disk is full for example. What was
            there before is untouched.
    """
    if set(contents) != set(_KEYS):
        raise ValueError(f"a checkpoint holds {sorted(_KEYS)}, got {sorted(contents)}")
    buffer = io.BytesIO()
    torch.save({"format": FORMAT, "version": VERSION, **contents}, buffer)
    path = Path(path)
    try:
        _write_atomically(path, buffer.getbuffer())
    except OSError as error:
        kept = "the previous one is intact" if path.exists() else "nothing was written"
        raise OSError(error.errno, f"cannot write checkpoint ({error.strerror}; {kept})", str(path)) from error


def load_checkpoint(path: str | os.PathLike[str], device: str | torch.device = "cpu") -> dict[str, Any]:
    """Read a checkpoint.

    Args:
        path: File that `save_checkpoint` wrote.
        device: Where its tensors go.

    Returns:
        The entries `policy`, `weights`, `optimizer`, `algorithm`, `value_scale`, `generators`, `train_config`,
        `iteration`, `global_step` and `best_score`.

    Raises:
        FileNotFoundError: If there is no such file.
        CheckpointError: If the file is truncated, of another program or of another version, or an entry is of another type.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no checkpoint at {path}")
    data = path.read_bytes()  # apart from the parsing, which reports a cut file as an OSError too
    unreadable = f"{path} cannot be read: it is truncated or not a checkpoint of this package ({len(data)} bytes)"
    # Anything but a zip archive would go to the parser of an old format, which fails in many ways.
    if not zipfile.is_zipfile(io.BytesIO(data)):
        raise CheckpointError(unreadable)
    try:
        contents = torch.load(io.BytesIO(data), map_location=device, weights_only=True)
    except _UNREADABLE as error:
        raise CheckpointError(unreadable) from error
    if not isinstance(contents, dict) or contents.get("format") != FORMAT:
        raise CheckpointError(f"{path} was written by another program, not by maniskill_grpd")
    version = contents.get("version")
    if version != VERSION:
        raise CheckpointError(f"{path} has checkpoint version {version}, this package reads {VERSION}")
    missing = sorted(set(_KEYS) - set(contents))
    if missing:
        raise CheckpointError(f"{path} lacks {', '.join(missing)}")
    for key, expected in _TYPES.items():
        if not isinstance(contents[key], expected) or (expected is int and contents[key] < 0):
            raise CheckpointError(f"{path}: its entry {key!r} is damaged: {_shorten(repr(contents[key]))} is not {_KEYS[key]}")
    return {key: contents[key] for key in _KEYS}


@contextmanager
def reading(path: str | os.PathLike[str], entry: str) -> Iterator[None]:
    """Name file and entry where an entry of a checkpoint is not what its reader expects.

    Raises:
        CheckpointError: In place of the reader's own error.
    """
    try:
        yield
    except CheckpointError:
        raise
    except _MISFITS as error:
        reason = _shorten(" ".join(f"{type(error).__name__}: {error}".split()))
        raise CheckpointError(f"{path}: its entry {entry!r} is damaged: {reason}") from error


def restore_policy(policy: torch.nn.Module, contents: dict[str, Any]) -> None:
    """Load the weights of a checkpoint into a policy built with the same options.

    Args:
        policy: Has `config`, plain types that tell policies of different shape apart.
        contents: A loaded checkpoint.

    Raises:
        CheckpointError: If the checkpoint is of a policy with other options or another schema, or its weights are of another one.
    """
    differences = describe_differences(contents["policy"], policy.config)
    if differences:
        raise CheckpointError("the checkpoint does not fit this policy: " + "; ".join(differences[:8]))
    load_weights(policy, contents["weights"])


def load_weights(policy: torch.nn.Module, weights: dict[str, Any]) -> None:
    """Load weights, all or none.

    Raises:
        CheckpointError: If one is missing, unknown, of another shape, no tensor or not finite.
    """
    own = policy.state_dict()
    faults = [f"{name} is missing" for name in own.keys() - weights.keys()]
    faults += [f"{name!r} is unknown" for name in weights.keys() - own.keys()]
    for name in own.keys() & weights.keys():
        faults += [f"{name} {fault}" for fault in _weight_faults(weights[name], own[name])]
    if faults:
        raise CheckpointError("the weights of the checkpoint do not fit this policy: " + "; ".join(sorted(faults)[:4]))
    policy.load_state_dict(weights)


def _weight_faults(given: Any, own: torch.Tensor) -> list[str]:
    if not isinstance(given, torch.Tensor):
        return [f"is no tensor but {_shorten(repr(given))}"]
    if given.shape != own.shape:
        return [f"has the shape {tuple(given.shape)}, here it is {tuple(own.shape)}"]
    if given.is_floating_point() != own.is_floating_point():
        return [f"is of type {given.dtype}, here it is {own.dtype}"]
    return [] if torch.isfinite(given).all() else ["is not finite"]


def _shorten(text: str, length: int = 160) -> str:
    return text if len(text) <= length else f"{text[: length - 3]}..."


def describe_differences(stored: Any, given: Any, name: str = "") -> list[str]:
    """List where two nested structures of plain types differ, as "name: checkpoint has x, ..."."""
    if isinstance(stored, dict) and isinstance(given, dict):
        found = []
        for key in sorted(set(stored) | set(given), key=str):
            inner = f"{name}.{key}" if name else str(key)
            found += describe_differences(stored.get(key), given.get(key), inner)
        return found
    as_lists = [list(x) if isinstance(x, tuple) else x for x in (stored, given)]
    if as_lists[0] == as_lists[1]:
        return []
    return [f"{name}: the checkpoint has {stored!r}, here it is {given!r}"]


def _write_atomically(path: Path, data: memoryview) -> None:
    """Write beside the target, force to disk, then rename: a crash leaves one whole file."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError:
        temporary.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


def _sync_folder(folder: Path) -> None:
    """Make the rename itself survive a power cut, where the platform lets a folder be opened."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
