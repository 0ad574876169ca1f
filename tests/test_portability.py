"""Nothing in the package forbids a system on which it was not tried."""

import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

PACKAGE = Path(__file__).parent.parent / "maniskill_grpd"
WITHOUT_POSIX = """
import os, subprocess, sys
import matplotlib.pyplot, mani_skill, mani_skill.envs, scipy.spatial, torch, torch.utils.tensorboard, warp
for name in ("fcntl", "pwd", "grp", "termios", "resource"):
    sys.modules[name] = None
for name in ("sysconf", "sched_getaffinity", "fork", "getuid"):
    delattr(os, name)
sys.modules["msvcrt"] = msvcrt = type(sys)("msvcrt")
msvcrt.LK_NBLCK, held = 2, set()
def locking(descriptor, mode, length):
    file = os.fstat(descriptor).st_ino
    if file in held:
        raise PermissionError(13, "held")
    held.add(file)
msvcrt.locking = locking
sys.platform, name = "win32", sys.platform
import maniskill_grpd.runs.file_lock
sys.platform = name
"""
"""Once the libraries are there, leaves a Python with what Windows has, as far as the package could tell."""


def run_without_posix(program, folder):
    result = subprocess.run(
        [sys.executable, "-c", WITHOUT_POSIX + program], cwd=folder, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


def test_a_run_is_held_by_one_process_on_windows_too(tmp_path):
    program = """
from pathlib import Path
from maniskill_grpd.runs.folder import RunInUseError, hold_run
with hold_run(Path("a")):
    try:
        with hold_run(Path("a")):
            print("twice")
    except RunInUseError as error:
        print(error)
    with hold_run(Path("b")):
        print("other")
"""
    refused, other = run_without_posix(program, tmp_path).splitlines()
    assert "another process works at a" in refused
    assert other == "other"


def test_a_solver_steps_and_jobs_are_imported_without_posix(tmp_path):
    program = """
import maniskill_grpd.experiments.job
from maniskill_grpd.physics import Solver, rope
solver = Solver(rope([[0.0, 0.0], [0.2, 0.0]], num_nodes=5), 2, 1)
solver.step()
print(bool(solver.positions.isfinite().all()))
"""
    assert run_without_posix(program, tmp_path).splitlines()[-1] == "True"


def writes_without_encoding(text):
    """Return whether a call of `write_text` leaves the encoding to the system: Windows has another one."""
    for call in text.split(".write_text(")[1:]:
        depth, end = 1, 0
        while depth:
            depth += {"(": 1, ")": -1}.get(call[end], 0)
            end += 1
        if "encoding=" not in call[:end]:
            return True
    return False


def test_files_are_written_with_their_encoding_and_to_no_place_of_one_system():
    texts = {path: path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    assert [path for path, text in texts.items() if writes_without_encoding(text)] == []
    assert [path for path, text in texts.items() if "/dev/shm" in text or '"/tmp' in text] == []
    assert writes_without_encoding('a.write_text(f(x))\nb.write_text(x, encoding="utf-8")')
