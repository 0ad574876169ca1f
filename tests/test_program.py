"""How commands are called by name, and started as processes."""

import sys
from pathlib import Path

import pytest

from maniskill_grpd.program import command_line, process_arguments


def test_what_is_shown_can_be_typed():
    assert command_line(["plot", "runs/a b"]) == "maniskill-grpd plot 'runs/a b'"


def test_one_process_runs_the_package_and_several_go_through_the_launcher_of_pytorch():
    assert process_arguments(["train"]) == [sys.executable, "-m", "maniskill_grpd", "train"]
    several = process_arguments(["train"], 2)
    assert several[1:3] == ["-m", "torch.distributed.run"]
    assert "--nproc_per_node=2" in several
    assert several[-3:] == ["-m", "maniskill_grpd", "train"]


def test_a_wheel_holds_every_folder_of_the_package_and_says_that_it_has_types():
    """A folder without __init__.py runs from a checkout and is missing from a wheel."""
    find_packages, tomllib = pytest.importorskip("setuptools").find_packages, pytest.importorskip("tomllib")
    root = Path(__file__).parent.parent
    settings = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]
    found = set(find_packages(root, include=settings["packages"]["find"]["include"]))
    files = [path.relative_to(root) for path in (root / "maniskill_grpd").rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert {".".join(path.parent.parts) for path in files} == found
    data = {str(path.relative_to("maniskill_grpd")) for path in files if path.suffix != ".py"}
    assert data == set(settings["package-data"]["maniskill_grpd"]) == {"py.typed", "viewer/replay_player.html"}
