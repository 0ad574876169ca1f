"""Reading what RecordEpisode wrote."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from maniskill_grpd.tasks.options.env_id import check_env_id

StateSequence = dict[str, Any]
"""Nested dictionary whose leaves are (T + 1, D)."""


class RecordingError(ValueError):
    """A recording cannot be used; the message names the file and says why."""


@dataclass(frozen=True)
class Episode:
    """One recorded episode of T steps."""

    name: str
    """Its group in the .h5 file."""
    seed: int
    """Seed that started it."""
    control_mode: str
    """Control mode that its actions are for."""
    actions: np.ndarray
    """(T, D)."""
    states: StateSequence | None
    """States before the first and after each step; None where they were not recorded."""

    def state(self, step: int) -> dict[str, Any]:
        """Return the state after `step` steps, leaves (D,); the last one from the end of the episode on."""
        assert self.states is not None
        return _row(self.states, min(step, len(self.actions)))


@dataclass(frozen=True)
class Recording:
    """Episodes of one task."""

    path: Path
    """The .h5 file."""
    env_id: str
    """Id of the task."""
    env_kwargs: dict[str, Any]
    """Options it was made with."""
    max_episode_steps: int | None
    """Its limit of steps."""
    episodes: tuple[Episode, ...]


def read_recording(path: Path, *, count: int | None = None, allow_import: bool = False) -> Recording:
    """Read the .h5 file of a recording and the .json file beside it.

    Args:
        path: The .h5 file.
        count: How many episodes to read, all by default.
        allow_import: Whether the id of the task may name a module, which is imported when the task is made.

    Raises:
        FileNotFoundError: If one of the files is missing.
        RecordingError: If one of them is damaged or lacks something that is needed.
    """
    record_path = path.with_suffix(".json")
    for file in (path, record_path):
        if not file.is_file():
            raise FileNotFoundError(f"no recorded trajectory: {file} is missing")
    record = _read_json(record_path)
    info = _entry(record, "env_info", Mapping, record_path)
    try:
        env_id = check_env_id(info.get("env_id"), str(record_path), allow_import=allow_import)
    except ValueError as error:
        raise RecordingError(str(error)) from None
    listed = _entry(record, "episodes", Sequence, record_path)[:count]
    if not listed:
        raise RecordingError(f"{record_path} lists no episodes: nothing to replay")
    limit = info.get("max_episode_steps")
    if limit is not None and (not isinstance(limit, int) or limit < 1):
        raise RecordingError(f"{record_path}: max_episode_steps must be a positive number, got {limit!r}")
    kwargs = dict(_entry(info, "env_kwargs", Mapping, record_path))
    return Recording(path, env_id, kwargs, limit, _read_episodes(path, listed, record_path))


def _read_json(path: Path) -> Mapping[str, Any]:
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:  # broken UTF-8 is one too
        raise RecordingError(f"{path} is not whole: {error}") from error
    if not isinstance(record, Mapping):
        raise RecordingError(f"{path} must hold an object, got {type(record).__name__}")
    return record


def _entry(record: Mapping[str, Any], name: str, kind: type, path: Path) -> Any:
    value = record.get(name)
    if not isinstance(value, kind) or isinstance(value, str):
        raise RecordingError(f"{path} has no {name!r}, without which its episodes cannot be replayed")
    return value


def _read_episodes(path: Path, listed: Sequence[Any], record_path: Path) -> tuple[Episode, ...]:
    try:
        with h5py.File(path, "r") as file:
            return tuple(_read_episode(file, entry, record_path) for entry in listed)
    except OSError as error:  # what h5py raises for files that are cut short, at opening or at reading
        raise RecordingError(f"{path} is not whole: {error}") from error


def _read_episode(file: h5py.File, entry: Any, record_path: Path) -> Episode:
    if not isinstance(entry, Mapping) or not {"episode_id", "episode_seed", "control_mode"} <= entry.keys():
        raise RecordingError(f"{record_path}: an episode needs episode_id, episode_seed and control_mode, got {entry!r:.80}")
    name = f"traj_{entry['episode_id']}"
    group = file.get(name)
    actions = group.get("actions") if isinstance(group, h5py.Group) else None
    if not isinstance(actions, h5py.Dataset) or actions.ndim != 2 or not len(actions):
        raise RecordingError(f"{file.filename} lacks the actions (steps, numbers) of {name}, which {record_path.name} lists")
    if not isinstance(entry["episode_seed"], int):
        raise RecordingError(f"{record_path}: episode_seed of {name} must be a whole number, got {entry['episode_seed']!r}")
    states = _read_tree(group["env_states"]) if isinstance(group.get("env_states"), h5py.Group) else None
    for leaf in _leaves(states or {}):
        if len(leaf) != len(actions) + 1:
            raise RecordingError(f"{file.filename}: {name} has {len(actions)} actions but {len(leaf)} states, expected one more")
    return Episode(name, entry["episode_seed"], _control_mode(entry["control_mode"], record_path), actions[:], states)


def _control_mode(recorded: Any, record_path: Path) -> str:
    """Return the control mode of an episode; several agents have one entry each, all the same."""
    modes = set(map(str, recorded.values())) if isinstance(recorded, Mapping) else {str(recorded)}
    if len(modes) != 1:
        raise RecordingError(f"{record_path}: all agents of an episode must have one control mode, got {sorted(modes)}")
    return modes.pop()


def _read_tree(group: h5py.Group) -> StateSequence:
    return {key: _read_tree(value) if isinstance(value, h5py.Group) else value[:] for key, value in group.items()}


def _leaves(tree: StateSequence) -> list[np.ndarray]:
    return [leaf for value in tree.values() for leaf in (_leaves(value) if isinstance(value, dict) else [value])]


def _row(tree: StateSequence, index: int) -> dict[str, Any]:
    return {key: _row(value, index) if isinstance(value, dict) else value[index] for key, value in tree.items()}
