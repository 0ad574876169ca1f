"""The gallery of the tasks."""

import pytest
from PIL import Image, ImageSequence

from maniskill_grpd.experts import EXPERTS
from tools.docs import task_gallery


def clip(color, num_frames):
    """Return frames of one colour."""
    return [Image.new("RGB", (8, 8), color) for _ in range(num_frames)]


def test_every_task_is_shown():
    assert set(task_gallery.episodes()) == set(EXPERTS)


def test_clips_run_side_by_side_and_wait_for_the_longest():
    frames = task_gallery.side_by_side([clip("red", 1), clip("blue", 3), clip("green", 2)])
    assert len(frames) == 3
    for frame in frames:
        assert frame.size == (16, 16)
        assert [frame.getpixel(at) for at in ((0, 0), (15, 0), (0, 15))] == [(255, 0, 0), (0, 0, 255), (0, 128, 0)]


def test_clips_play_in_real_time(tmp_path):
    shades = [Image.new("RGB", (8, 8), (shade, 0, 0)) for shade in range(0, 250, 50)]
    task_gallery.write_clip(shades, tmp_path / "clip.gif")
    with Image.open(tmp_path / "clip.gif") as written:
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(written)]
    assert durations == [50, 50, 50, 50, 1000]


def test_an_expert_that_fails_is_not_shown(monkeypatch):
    class Idle:
        def __init__(self, env):
            self.action = env.action_space.sample() * 0.0

        def act(self):
            return self.action

    monkeypatch.setattr(task_gallery, "make_expert", lambda env_id, env: Idle(env))
    monkeypatch.setattr(task_gallery, "_frame", lambda env: None)
    with pytest.raises(RuntimeError, match="RopeShaping-v1 does not succeed from seed 11"):
        task_gallery.play_expert("RopeShaping-v1", task_gallery.episodes()["RopeShaping-v1"])
