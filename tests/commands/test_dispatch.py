"""One program, its commands, and what it says about mistakes."""

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import COMMANDS, main
from maniskill_grpd.commands.dispatch import describe_unknown
from maniskill_grpd.commands.run_command import _unframed

PACKAGE = Path(importlib.import_module("maniskill_grpd").__file__).parent
NEEDED = {
    "plot": ["runs"],
    "study": ["--study", "main"],
    "sweep": ["--name", "s"],
    "evaluate_study": ["--study", "main", "--checkpoint", "a.pt"],
    **dict.fromkeys(("evaluate", "inspect", "interpret", "video"), ["--checkpoint", "a.pt"]),
}
"""What a command asks for, by its name."""
NOT_COMMANDS = {"__init__", "dispatch", "run_command", "study_tasks"}


def test_every_module_is_a_command_and_every_command_a_module():
    modules = {path.stem for path in (PACKAGE / "commands").glob("*.py")}
    assert modules - NOT_COMMANDS == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_command_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as exit_info:
        main([name, "--help"])
    assert exit_info.value.code == 0
    assert "usage: " in capsys.readouterr().out


@pytest.mark.parametrize("words", [[], ["--help"], ["-h"]])
def test_help_names_every_command_and_what_it_does(words, capsys):
    assert main(words) == 0
    printed = capsys.readouterr().out
    for name, purpose in COMMANDS.items():
        assert f"{name} " in printed
        assert purpose in printed


def test_an_unknown_command_is_one_line_with_those_there_are(capsys):
    assert main(["trian"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "unknown command 'trian', did you mean 'train'?" in line
    assert all(name in line for name in COMMANDS)
    assert "did you mean" not in describe_unknown("xyz")


def test_dashes_and_underscores_are_the_same_in_names_of_commands(capsys):
    assert main(["evaluate-expert", "--num-episodes", "0"]) == 2
    assert "num_episodes must be positive" in capsys.readouterr().err


@pytest.mark.parametrize("name", sorted(set(COMMANDS) - {"replay"}))
def test_an_unknown_option_is_one_line_with_those_there_are(name, capsys):
    assert main([name, *NEEDED.get(name, []), "--no_such_option", "3"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "--no_such_option" in line
    assert "takes --" in line


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--seed", "x"], "error: Error parsing --seed: invalid literal for int() with base 10: 'x'"),
        (["--algorithm", "trpo"], "error: invalid choice 'trpo' for argument '--algorithm'. Expected one of ('bpp', 'ppo')."),
        (["--gamma", "3"], "error: Error parsing TrainConfig: gamma must lie in [0, 1], got 3.0"),
    ],
)
def test_a_wrong_value_is_one_line_without_a_frame(words, message, capsys):
    assert main(["train", *words]) == 2
    assert capsys.readouterr().err.splitlines() == [message]


FRAMED = """╭─ Error ───╮
│ wrong is  │
│ --x       │
│ ───────── │
│ see help  │
╰───────────╯
"""
PLAIN = """ Error
 ---------
  wrong is
  --x
  ---------
  see help
"""


@pytest.mark.parametrize("text", [FRAMED, PLAIN])
def test_messages_are_taken_out_of_their_frames(text):
    assert _unframed(text) == "wrong is --x"


def test_scripts_of_baselines_forward_to_commands():
    """Every forwarder names a command that exists, and the program ends with its code."""
    folder = PACKAGE.parent / "baselines"
    forwarders = {path.stem: path.read_text() for path in folder.glob("*.py") if "import forward" in path.read_text()}
    assert {"train", "evaluate", "bc", "record_demonstrations"} <= set(forwarders)
    assert {text.split('forward("')[1].split('"')[0] for text in forwarders.values()} <= set(COMMANDS)
    command = [sys.executable, str(folder / "plot_learning_curve.py"), "none"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "error: " in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "--checkpoint", "none.pt", "--torch_threads", "100000"],
        ["evaluate", "--checkpoint", "none.pt", "--sigma", "inf"],
        ["evaluate_study", "--study", "noise", "--checkpoint", "none.pt", "--torch_threads", "100000"],
        ["clone", "--torch_threads", "0"],
        ["train", "--torch_threads", "100000"],
    ],
)
def test_numbers_out_of_their_range_are_refused_by_every_command(words, capsys):
    """A hundred thousand threads crashed the process."""
    assert main(words) != 0
    assert "must lie in [" in capsys.readouterr().err
