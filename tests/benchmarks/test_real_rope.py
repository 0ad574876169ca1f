"""The benchmark on real cables finds the material of a recording that the solver made itself."""

import importlib.util
import pickle
from pathlib import Path

import numpy as np
import pytest
import torch

SPEC = importlib.util.spec_from_file_location("real_rope", Path(__file__).parents[2] / "benchmarks" / "real_rope.py")
benchmark = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(benchmark)

STIFFNESS, DRAG = 0.03, 1.5
SEGMENTS = np.array([0.03, 0.11, 0.1, 0.09, 0.1, 0.11, 0.03])


def moving_clamps(num_frames: int = 120) -> torch.Tensor:
    """Frames (2, T, 8, 3) whose first and last two markers go to and fro; the others are where they start."""
    places = torch.as_tensor(np.concatenate([[0.0], np.cumsum(SEGMENTS)]), dtype=torch.float32)
    frames = torch.zeros(2, num_frames, len(places), 3)
    frames[..., 0] = places
    time = torch.arange(num_frames) * benchmark.FRAME_TIME
    frames[:, :, :, 2] += 0.1 * (1.0 - torch.cos(6.0 * time))[None, :, None]
    frames[1, :, :, 1] += 0.1 * (1.0 - torch.cos(9.0 * time))[:, None]
    frames[:, :, -2:, 0] -= 0.05 * (1.0 - torch.cos(5.0 * time))[None, :, None]
    return frames


def write(folder: Path, recordings: torch.Tensor) -> None:
    for part in ("train", "eval"):
        (folder / "DLO1" / part).mkdir(parents=True)
        for index, recording in enumerate(recordings):
            (folder / "DLO1" / part / f"{index}.pkl").write_bytes(pickle.dumps(recording.numpy().transpose(0, 2, 1)))


def test_stiffness_and_drag_are_found_again(tmp_path, monkeypatch):
    monkeypatch.setattr(benchmark, "mean_segments", lambda recordings: SEGMENTS)
    write(tmp_path, benchmark.simulate(moving_clamps(), SEGMENTS, STIFFNESS, DRAG))
    row = benchmark.measure(tmp_path, "DLO1")
    assert row["stiffness"] == pytest.approx(STIFFNESS, rel=0.2)
    assert row["drag"] == pytest.approx(DRAG, abs=0.3)
    assert row["error"] < 1e-3 < 5e-3 < row["error_without_bending"]


def test_segments_are_those_between_the_markers():
    np.testing.assert_allclose(benchmark.mean_segments(moving_clamps()[:, :1]), SEGMENTS, rtol=1e-5)


def test_missing_recordings_are_named_with_their_source(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no recordings .*DLO1.train.*github.com/roahmlab/DEFORM.*data_set"):
        benchmark.measure(tmp_path, "DLO1")


def test_a_pickle_that_is_no_array_is_refused(tmp_path):
    (tmp_path / "DLO1" / "train").mkdir(parents=True)
    (tmp_path / "DLO1" / "train" / "0.pkl").write_bytes(pickle.dumps(print))
    with pytest.raises(pickle.UnpicklingError, match=r"this file wants builtins.print"):
        benchmark.load_recordings(tmp_path, "DLO1", "train")
