"""metrics.jsonl: a line cut short by a crash is left out, other damage is named and stops no run."""

import json

import pytest

from maniskill_grpd.learning.run_log import read_rows, truncate_rows


def row(iteration):
    return {"kind": "train", "iteration": iteration, "global_step": 10 * iteration, "train/return": 1.0}


def write(path, *lines):
    path.write_bytes(b"".join(line if isinstance(line, bytes) else json.dumps(line).encode() + b"\n" for line in lines))
    return path


def test_a_row_that_a_crash_cut_short_is_dropped(tmp_path):
    assert read_rows(write(tmp_path / "metrics.jsonl", row(1), b'{"kind": "tra')) == [row(1)]


@pytest.mark.parametrize("damage", [b'{"kind": "tra\n', b"\xff\xfe\x00\n", b"[1, 2]\n", b'{"kind": "train"}\n', b"\n"])
def test_a_damaged_line_is_named_and_a_run_goes_on_without_it(tmp_path, damage, capsys):
    """It was a bare JSONDecodeError or KeyError, and the run could not be resumed."""
    path = write(tmp_path / "metrics.jsonl", row(1), damage, row(2), row(3))
    damaged = path.read_bytes()
    with pytest.raises(ValueError, match=r"metrics.jsonl, line 2: damaged"):
        read_rows(path)
    assert truncate_rows(path, 2) == 20
    assert read_rows(path) == [row(1), row(2)]
    assert "metrics.jsonl, line 2: damaged; 1 line(s) left out" in capsys.readouterr().err
    assert (tmp_path / "damaged_metrics.jsonl").read_bytes() == damaged


def test_an_intact_log_is_not_kept_aside(tmp_path):
    path = write(tmp_path / "metrics.jsonl", row(1), row(2))
    assert truncate_rows(path, 1) == 10
    assert [found.name for found in tmp_path.iterdir()] == ["metrics.jsonl"]
