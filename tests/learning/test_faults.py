"""Runs that are killed, disks that are full, numbers that are not finite: nothing is lost or hidden."""

import dataclasses
import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from toy_env import ToyEnv, ToyPolicy
from toy_run import CONFIG, make_toy_trainer

from maniskill_grpd.learning import NonFiniteError, Trainer, load_checkpoint
from maniskill_grpd.learning.run_log import read_rows

SCRIPT = Path(__file__).with_name("run_fault.py")
ENV = {**os.environ, "OMP_NUM_THREADS": "1"}


def run_until_killed(run_dir, place, call):
    """Train in a process that kills itself at the given call of a function."""
    done = subprocess.run(
        [sys.executable, str(SCRIPT), str(run_dir), place, str(call)], capture_output=True, env=ENV, timeout=100, check=False
    )
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Return the final checkpoint of a run without interruption."""
    run_dir = tmp_path_factory.mktemp("unbroken")
    make_toy_trainer(run_dir).train()
    return load_checkpoint(run_dir / "final_ckpt.pt"), read_rows(run_dir / "metrics.jsonl", "train")


@pytest.mark.skipif(os.name != "posix", reason="SIGKILL")
@pytest.mark.parametrize(
    ("place", "call", "kept"),
    [
        ("env_step", 7 + 7 * 7 + 3 * 10 + 3, 6),  # warm-up, seven rollouts, three evaluations, three steps
        ("adam_step", 8 * 4 + 3, 3),  # within the fifth update
        ("evaluate", 3, 3),  # before best_ckpt.pt of iteration 6 is chosen
        ("half_written", 2, 3),  # last.pt of iteration 6 is half on the disk
        ("before_rename", 2, 3),  # and wholly, under its temporary name
        ("after_rename", 2, 6),  # and in its place
        ("log", 5, 3),  # within a line of metrics.jsonl
    ],
)
def test_a_run_killed_anywhere_goes_on_and_ends_bitwise_the_same(tmp_path, unbroken, place, call, kept):
    run_until_killed(tmp_path, place, call)
    assert load_checkpoint(tmp_path / "last.pt")["iteration"] == kept
    trainer = make_toy_trainer(tmp_path)
    trainer.load(tmp_path / "last.pt")
    trainer.train()
    final, rows = load_checkpoint(tmp_path / "final_ckpt.pt"), read_rows(tmp_path / "metrics.jsonl", "train")
    for key in ("weights", "optimizer", "value_scale", "generators"):
        torch.testing.assert_close(final[key], unbroken[0][key], rtol=0, atol=0)
    returns = [[row.get("train/return") for row in table] for table in (rows, unbroken[1])]
    assert returns[0] == returns[1]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_stops_training_and_keeps_the_last_checkpoint(tmp_path):
    class FillingEnv(ToyEnv):
        def step(self, action):
            if self.total_steps == 7 + 7 * 5:  # in iteration 5: the checkpoint of 3 is written
                os.symlink("/dev/full", tmp_path / f".last.pt.{os.getpid()}.tmp")
            return super().step(action)

    trainer = Trainer(dataclasses.replace(CONFIG, eval_freq=0), ToyPolicy(), FillingEnv(8), None, tmp_path)
    with pytest.raises(OSError, match="cannot write checkpoint .*previous one is intact") as error:
        trainer.train()
    assert error.value.errno == errno.ENOSPC
    assert load_checkpoint(tmp_path / "last.pt")["iteration"] == 3


@pytest.mark.parametrize("region", ["projection", "lagrangian", "fisher"])
def test_a_nan_in_the_loss_stops_before_the_weights(tmp_path, region):
    """An advantage that is not finite, as an overflowing value function would make it."""
    config = dataclasses.replace(CONFIG, trust_region=region, eval_freq=0)
    trainer = Trainer(config, ToyPolicy(), ToyEnv(8), None, tmp_path)
    estimate = trainer._estimate_advantages

    def overflow(rollout):
        estimate(rollout)
        if trainer.state.iteration == 4:
            rollout.advantages[2, 3] = torch.inf

    trainer._estimate_advantages = overflow
    with pytest.raises(NonFiniteError, match="gradient .*not finite"):
        trainer.train()
    assert all(torch.isfinite(parameter).all() for parameter in trainer.policy.parameters())
    assert load_checkpoint(tmp_path / "last.pt")["iteration"] == 3
