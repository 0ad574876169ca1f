"""How commands are called by name, and started as processes."""

import sys

from maniskill_grpd.program import command_line, process_arguments


def test_what_is_shown_can_be_typed():
    assert command_line(["plot", "runs/a b"]) == "maniskill-grpd plot 'runs/a b'"


def test_one_process_runs_the_package_and_several_go_through_the_launcher_of_pytorch():
    assert process_arguments(["train"]) == [sys.executable, "-m", "maniskill_grpd", "train"]
    several = process_arguments(["train"], 2)
    assert several[1:3] == ["-m", "torch.distributed.run"]
    assert "--nproc_per_node=2" in several
    assert several[-3:] == ["-m", "maniskill_grpd", "train"]
