"""Threads of a solver across a fork, and what Warp says when a solver is made."""

import os
import subprocess
import sys

import pytest

PREPARE = """
import os
import numpy as np, torch
from maniskill_grpd.physics import Solver, rope
torch.set_num_threads(1)
line = np.linspace([0.0, 0.0, 1.0], [0.4, 0.0, 1.0], 11)
solver = Solver(rope(line, num_nodes=11), 64, 1, num_threads=2)
solver.step()
"""
STEP_IN_BOTH = """
child = os.fork()
solver.step()
assert (solver.positions[:, :, 2] < 1.0).all()
if child == 0:
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
solver.step()
"""


def run(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=120)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked there")
def test_parent_and_forked_child_step_with_threads_of_their_own():
    run(PREPARE + STEP_IN_BOTH)


def test_making_a_solver_prints_nothing_and_leaves_the_log_level_alone():
    printed = run("import warp as wp\nbefore = wp.config.log_level\n" + PREPARE + "assert wp.config.log_level == before\n").stdout
    assert printed == ""
