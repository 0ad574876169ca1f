"""Replays: what is read back from the page is what was shown, and the page is whole, small and harmless."""

import base64
import json
import re
import zlib

import numpy as np
import pytest

from maniskill_grpd.viewer.parts import Copies, Look, Shell
from maniskill_grpd.viewer.replay import Replay

FACES = np.array([[0, 1, 2], [0, 2, 3]])
LOOK = Look((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
TOWARDS = np.array([0.0, -1.0, 1.0])


def shell(vertices: np.ndarray, faces: np.ndarray = FACES) -> Shell:
    return Shell(vertices.astype(np.float32), faces, LOOK)


def copies(positions: np.ndarray, rotations: np.ndarray) -> Copies:
    return Copies(np.eye(4, 3, dtype=np.float32), FACES, LOOK, positions.astype(np.float32), rotations.astype(np.float32))


def read(page: str) -> tuple[dict, list[list[np.ndarray | None]]]:
    """Return the header of a page, and what each of its tracks shows in each frame, by the description of the format."""
    header = json.loads(re.search(r'<script id="header"[^>]*>(.*?)</script>', page, re.DOTALL).group(1))
    blob = zlib.decompress(base64.b64decode(re.search(r'<script id="data"[^>]*>(.*?)</script>', page, re.DOTALL).group(1)))

    def words(start: int, count: int) -> np.ndarray:
        low, high = (np.frombuffer(blob[at : at + count], np.uint8).astype(np.int64) for at in (start, start + count))
        return low + 256 * high

    tracks = []
    for track in header["tracks"]:
        states, rows, columns = track["shape"]
        numbers = words(*track["values"]).reshape(states, columns, rows).cumsum(axis=0)
        numbers = ((numbers + 32768) % 65536 - 32768).transpose(0, 2, 1)
        units = np.array([header["positionStep"]] * 3 + [header["rotationStep"]] * (columns - 3))
        index = [value for value, count in zip(track["index"][::2], track["index"][1::2], strict=True) for _ in range(count)]
        assert len(index) == header["numFrames"]
        tracks.append([None if state < 0 else numbers[state] * units for state in index])
    return header, tracks


def test_every_frame_is_read_back_to_half_a_tenth_of_a_millimetre():
    random = np.random.default_rng(0)
    frames = [random.uniform(-3.0, 3.0, (4, 3)) for _ in range(30)]
    replay = Replay("title", 0.05, TOWARDS)
    for number, vertices in enumerate(frames):
        replay.add({"object": shell(vertices)}, f"step {number}")
    header, (track,) = read(replay.html())
    assert header["captions"] == [f"step {number}" for number in range(30)]
    assert header["frameTime"] == 0.05
    for shown, vertices in zip(track, frames, strict=True):
        assert np.abs(shown - vertices).max() < 0.51e-4


def test_wide_scenes_get_coarser_steps_instead_of_wrapping_around():
    replay = Replay("wide", 0.05, TOWARDS)
    vertices = np.array([[-40.0, 0, 0], [40.0, 0, 0], [0, 40.0, 0], [0, 0, 0.0]])
    replay.add({"object": shell(vertices)})
    _, (track,) = read(replay.html())
    assert np.abs(track[0] - vertices).max() < 1e-3


def test_rigid_bodies_are_stored_once_and_their_poses_are_read_back():
    turns = np.array([[1.0, 0, 0, 0], [0.6, 0.0, 0.8, 0.0]])
    places = [np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([[0.1, 0.2, 0.3], [1.0, -1.0, 0]])]
    replay = Replay("rigid", 0.05, TOWARDS)
    for positions in places:
        replay.add({"grippers": copies(positions, turns)})
    header, (track,) = read(replay.html())
    assert header["tracks"][0]["mesh"][1] == 12
    for shown, positions in zip(track, places, strict=True):
        assert np.abs(shown - np.concatenate([positions, turns], axis=1)).max() < 1e-4


def test_parts_come_and_go_and_take_other_forms():
    square, corner = np.eye(4, 3), np.eye(3)
    replay = Replay("changes", 0.05, TOWARDS)
    for parts in ({"a": shell(square)}, {}, {"a": shell(corner, FACES[:1])}, {"a": shell(square + 1.0)}):
        replay.add(parts)
    _, (whole, part) = read(replay.html())
    assert [values is not None for values in whole] == [True, False, False, True]
    assert [values is not None for values in part] == [False, False, True, False]
    assert np.abs(whole[3] - square - 1.0).max() < 1e-4


def test_a_hundred_steps_of_a_cloth_of_a_hundred_nodes_are_far_below_two_megabytes_even_if_it_writhes():
    random = np.random.default_rng(0)
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10), [0.0], indexing="ij"), axis=-1).reshape(-1, 3) * 0.05
    corner = np.arange(90).reshape(9, 10)[:, :9].ravel()
    faces = np.concatenate([np.stack([corner, corner + 10, corner + 11], 1), np.stack([corner, corner + 11, corner + 1], 1)])
    replay = Replay("cloth", 0.05, TOWARDS)
    for _ in range(101):
        replay.add({"object": shell(grid + random.uniform(-0.5, 0.5, grid.shape), faces)})
    assert len(replay.html()) < 300_000


def test_the_page_asks_for_nothing_from_elsewhere_and_words_stay_words():
    replay = Replay("</script><script>alert(1)</script> & more", 0.05, TOWARDS)
    replay.add({"object": shell(np.eye(4, 3))}, "</script><b>")
    page = replay.html()
    assert not re.search(r"https?://|src=|href=|@import|fetch\(", page)
    assert page.count("</script>") == 3
    header, _ = read(page)
    assert header["title"] == "</script><script>alert(1)</script> & more"
    assert "&lt;/script&gt;&lt;script&gt;alert(1)" in page


def test_nothing_and_too_much_are_refused():
    with pytest.raises(ValueError, match="at least one frame"):
        Replay("empty", 0.05, TOWARDS).html()
    replay = Replay("much", 0.05, TOWARDS)
    replay.add({"object": shell(np.zeros((70_000, 3)))})
    with pytest.raises(ValueError, match=r"65,536 vertices, got 70,000"):
        replay.html()
