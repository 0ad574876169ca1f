"""A training that is asked to stop ends after its iteration, and goes on from there."""

import dataclasses

import pytest
import torch
from toy_env import ToyEnv, ToyPolicy
from toy_run import CONFIG, make_toy_trainer

from maniskill_grpd.learning import Trainer, load_checkpoint
from maniskill_grpd.learning.stopping import TrainingStoppedError

EVERY = dataclasses.replace(CONFIG, checkpoint_freq=1)


def train_until(run_dir, iteration, config=CONFIG):
    """Train, and ask to stop once some iterations are finished; the request comes while the next has not begun."""
    trainer = make_toy_trainer(run_dir, config)
    trainer._should_stop = lambda: trainer.state.iteration >= iteration
    trainer.train()


def go_on(run_dir, config=CONFIG):
    trainer = make_toy_trainer(run_dir, config)
    trainer.load(run_dir / "last.pt")
    trainer.train()
    return load_checkpoint(run_dir / "final_ckpt.pt")


@pytest.mark.parametrize("iteration", [1, 3, 4])
def test_a_checkpoint_of_the_iteration_is_written_whether_one_was_due_or_not(tmp_path, iteration):
    with pytest.raises(TrainingStoppedError, match=rf"stopped after {iteration} of 9 iterations; checkpoint {tmp_path}/last.pt"):
        train_until(tmp_path, iteration)
    assert load_checkpoint(tmp_path / "last.pt")["iteration"] == iteration
    assert not (tmp_path / "final_ckpt.pt").exists()
    assert go_on(tmp_path)["iteration"] == 9


def test_a_run_that_saves_every_iteration_ends_bitwise_as_if_never_stopped(tmp_path):
    make_toy_trainer(tmp_path / "whole", EVERY).train()
    with pytest.raises(TrainingStoppedError):
        train_until(tmp_path / "stopped", 4, EVERY)
    whole, stopped = load_checkpoint(tmp_path / "whole" / "final_ckpt.pt"), go_on(tmp_path / "stopped", EVERY)
    for key in ("weights", "optimizer", "value_scale", "generators"):
        torch.testing.assert_close(whole[key], stopped[key], rtol=0, atol=0)


def test_a_request_in_the_last_iteration_lets_the_run_end(tmp_path):
    train_until(tmp_path, 9)
    assert load_checkpoint(tmp_path / "final_ckpt.pt")["iteration"] == 9


def test_without_checkpoints_it_says_that_there_is_none(tmp_path):
    config = dataclasses.replace(CONFIG, save_model=False)
    with pytest.raises(TrainingStoppedError, match="without a checkpoint"):
        train_until(tmp_path, 2, config)
    assert not (tmp_path / "last.pt").exists()


def test_one_process_that_is_asked_stops_all(tmp_path):
    """Or the others would wait for its gradients for ever."""
    trainer = Trainer(CONFIG, ToyPolicy(), ToyEnv(8), None, tmp_path)
    trainer.workers = type("Other", (), {"gather": staticmethod(lambda own: [own, True]), "is_first": True})()
    trainer.state.workers = trainer.workers
    trainer.state.to_checkpoint = dict
    trainer.config = dataclasses.replace(CONFIG, save_model=False)
    with pytest.raises(TrainingStoppedError):
        trainer._stop_if_asked()
