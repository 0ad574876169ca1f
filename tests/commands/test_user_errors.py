"""What a user can help is one line that names the remedy, and nothing is left half done."""

import errno
import os
import subprocess
import sys

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.commands.run_command import report_errors
from maniskill_grpd.program import process_arguments


def only_line(capsys):
    (line,) = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error")]
    return line


@pytest.mark.parametrize(
    ("code", "remedy"),
    [
        (errno.EACCES, "work in a folder where you may write; caches go where WARP_CACHE_PATH"),
        (errno.EROFS, "work in a folder where you may write"),
        (errno.ENOSPC, "free some space"),
    ],
)
def test_errors_of_the_system_say_what_to_do(code, remedy, capsys):
    def fail():
        raise OSError(code, os.strerror(code), "runs")

    assert report_errors(fail) == 1
    line = only_line(capsys)
    assert os.strerror(code) in line
    assert remedy in line


def test_files_that_are_missing_have_no_remedy_but_their_name(tmp_path, capsys):
    assert report_errors((tmp_path / "no.pt").read_bytes) == 1
    line = only_line(capsys)
    assert "no.pt" in line
    assert "WARP_CACHE_PATH" not in line


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs a file system that is full")
def test_a_full_disk_is_one_line(capsys):
    def fill():
        with open("/dev/full", "w") as file:
            file.write("x" * 100_000)

    assert report_errors(fill) == 1
    assert "free some space" in only_line(capsys)


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path, monkeypatch, capsys):
    """A file stands where the folder should be: even an administrator cannot make it there."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").write_text("a file")
    assert main(["train", "--total_timesteps", "20", "--num_envs", "2", "--num_steps", "5", "--num_minibatches", "1"]) == 1
    assert only_line(capsys).startswith("error: ")
    assert (tmp_path / "runs").read_text() == "a file"


def test_a_compiler_cache_that_cannot_be_made_is_one_line(tmp_path):
    (tmp_path / "cache").write_text("a file")
    words = ["evaluate_expert", "--env_id", "RopeShaping-v1", "--num_episodes", "1", "--num_envs", "1"]
    environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path / "cache" / "warp")}
    result = subprocess.run(process_arguments(words), env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert "Traceback" not in result.stderr
    assert "caches go where WARP_CACHE_PATH" in result.stderr.splitlines()[-1]


def test_the_viewer_without_its_library_is_one_line(monkeypatch, capsys):
    for name in [name for name in sys.modules if name.partition(".")[0] == "viser"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "viser", None)
    assert main(["play", "--env_id", "RopeShaping-v1", "--num_envs", "1"]) == 1
    assert only_line(capsys) == "error: the viewer needs viser: pip install 'maniskill-grpd[viewer]'"
