"""Replays: one HTML file that shows what happened from all sides, without a server and without a network.

The file holds its own player (`replay_player.html`) and the data: positions in steps of 0.1 mm, rotations in steps of 3e-5, as
16-bit differences from frame to frame, deflated, in base64. What does not change is stored once.
"""

from __future__ import annotations

import base64
import html
import json
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from maniskill_grpd.viewer.framing import View, frame
from maniskill_grpd.viewer.parts import Part, Shell, same_array, same_mesh

POSITION_STEP = 1e-4
"""Unit of positions [m]; coarser where what is shown is wider than 6.5 m."""
ROTATION_STEP = 1.0 / 32767
LARGEST = 32767
MOST_VERTICES = 65536
PLAYER = "replay_player.html"


@dataclass
class _Track:
    """One mesh over all frames."""

    part: Part
    """As it was first seen."""
    values: list[np.ndarray] = field(default_factory=list)
    """The different states it was in: vertices (n, 3), or positions and rotations side by side (m, 7)."""
    index: list[int] = field(default_factory=list)
    """Which of them each frame shows, -1 for none."""


class Replay:
    """Frames of what there was to see.

    Args:
        title: What the page says above.
        frame_time: Duration of a frame in real time [s].
        towards: Direction in which the viewer stands at first, (3,).
    """

    def __init__(self, title: str, frame_time: float, towards: np.ndarray) -> None:
        self.title = title
        self._frame_time = frame_time
        self._towards = towards
        self._tracks: dict[str, list[_Track]] = {}
        self._captions: list[str] = []

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._captions)

    def add(self, parts: Mapping[str, Part], caption: str = "") -> None:
        """Append a frame; a caption stands below it."""
        number = len(self)
        for name, part in parts.items():
            self._add_part(self._track_of(name, part), part, number)
        self._captions.append(caption)

    def html(self) -> str:
        """Return the page.

        Raises:
            ValueError: If there is no frame, or a part has too many vertices.
        """
        if not len(self):
            raise ValueError("a replay needs at least one frame")
        tracks = [track for tracks in self._tracks.values() for track in tracks]
        largest = max((len(track.part.vertices) for track in tracks), default=0)
        if largest > MOST_VERTICES:
            raise ValueError(f"a replay holds parts of at most {MOST_VERTICES:,} vertices, got {largest:,}; show fewer worlds")
        blob = bytearray()
        step = max(POSITION_STEP, max(_extent(track) for track in tracks) / LARGEST)
        header = {
            "title": self.title,
            "frameTime": self._frame_time,
            "numFrames": len(self),
            "captions": self._captions,
            "camera": [np.round(point, 4).tolist() for point in self._camera(tracks)],
            "positionStep": step,
            "rotationStep": ROTATION_STEP,
            "tracks": [_described(track, blob, step, len(self)) for track in tracks],
        }
        data = base64.b64encode(zlib.compress(bytes(blob), 9)).decode("ascii")
        page = files(__package__).joinpath(PLAYER).read_text(encoding="utf-8")
        # "<" could end the script that holds the header.
        described = json.dumps(header, separators=(",", ":")).replace("<", "\\u003c")
        return page.replace("@TITLE@", html.escape(self.title)).replace("@HEADER@", described).replace("@DATA@", data)

    def write(self, path: Path) -> Path:
        """Write the page; folders that are missing are made."""
        text = self.html()
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return path

    def _camera(self, tracks: Iterable[_Track]) -> View:
        """Return from where everything is seen at all times."""
        return frame((_at(track, state) for track in tracks for state in range(len(track.values))), self._towards)

    def _track_of(self, name: str, part: Part) -> _Track:
        tracks = self._tracks.setdefault(name, [])
        for track in tracks:
            if same_mesh(track.part, part):
                return track
        tracks.append(_Track(part))
        return tracks[-1]

    def _add_part(self, track: _Track, part: Part, number: int) -> None:
        values = part.vertices if isinstance(part, Shell) else np.concatenate([part.positions, part.rotations], axis=1)
        if not track.values or not same_array(track.values[-1], values):
            track.values.append(values)
        track.index += [-1] * (number - len(track.index)) + [len(track.values) - 1]


def _at(track: _Track, state: int) -> Part:
    """Return the part in one of the states it was in."""
    values = track.values[state]
    if isinstance(track.part, Shell):
        return replace(track.part, vertices=values)
    return replace(track.part, positions=values[:, :3], rotations=values[:, 3:])


def _extent(track: _Track) -> float:
    """Return the largest coordinate of a track [m]."""
    places = [np.abs(values[:, :3]).max(initial=0.0) for values in track.values]
    return float(max(*places, 0.0 if isinstance(track.part, Shell) else np.abs(track.part.vertices).max(initial=0.0)))


def _described(track: _Track, blob: bytearray, step: float, num_frames: int) -> dict[str, Any]:
    """Return the header of a track; its numbers are appended to the blob."""
    part, look = track.part, track.part.look
    values = np.stack(track.values).astype(np.float64)
    units = np.full(values.shape[2], step)
    units[3:] = ROTATION_STEP
    header = {
        "front": look.front,
        "back": look.back or look.front,
        "opacity": look.opacity,
        "flat": look.is_flat,
        "index": _runs(track.index + [-1] * (num_frames - len(track.index))),
        "faces": _put(blob, part.faces.astype(np.int64).ravel()),
        "values": _put(blob, _differences(np.rint(values / units).astype(np.int64))),
        "shape": values.shape,
    }
    if not isinstance(part, Shell):
        header["mesh"] = _put(blob, np.rint(part.vertices.astype(np.float64) / step).astype(np.int64).T.ravel())
    return header


def _differences(values: np.ndarray) -> np.ndarray:
    """Return numbers (k, n, d) as differences along the first axis, coordinate by coordinate, which deflates best."""
    return np.diff(values, axis=0, prepend=0).transpose(0, 2, 1).ravel()


def _put(blob: bytearray, numbers: np.ndarray) -> tuple[int, int]:
    """Append numbers, as 16 bits that wrap around, low bytes before high ones; return where they start and how many they are."""
    start, words = len(blob), (numbers & 0xFFFF).astype(np.uint16)
    blob += (words & 0xFF).astype(np.uint8).tobytes() + (words >> 8).astype(np.uint8).tobytes()
    return start, len(words)


def _runs(index: list[int]) -> list[int]:
    """Return how often each value of a list follows itself: value, count, value, count ..."""
    runs: list[int] = []
    for value in index:
        if runs and runs[-2] == value:
            runs[-1] += 1
        else:
            runs += [value, 1]
    return runs
