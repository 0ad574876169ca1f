"""Runs that are started twice, and runs that were stopped early."""

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.learning import load_checkpoint
from maniskill_grpd.learning.trainer import Trainer
from maniskill_grpd.runs.folder import RunInUseError, hold_run

SIZES = "--num_envs 2 --num_steps 4 --num_minibatches 2 --update_epochs 1 --eval_freq 0 --total_timesteps 16 --no_capture_video"
TINY = f"train --exp_name one {SIZES} --sim_backend cpu --env_kwargs resolution=20 num_grippers=2".split()


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_two_processes_do_not_train_one_run(folder, capsys):
    """Both went on, and their results were mixed."""
    with hold_run(folder / "runs/one"):
        assert main(TINY) == 1
        assert "another process works at runs/one" in capsys.readouterr().err
        assert not (folder / "runs/one/config.json").exists()
        with pytest.raises(RunInUseError), hold_run(folder / "runs/one"):
            pass
    with hold_run(folder / "runs/one"):
        pass


def test_a_run_stopped_before_its_first_checkpoint_can_be_resumed(folder, monkeypatch, capsys):
    """Resuming asked for a checkpoint, and starting said that there was a run."""

    def stop(self):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "train", stop)
        assert main(TINY) == 130
    assert main(TINY) == 1
    assert "continue it with --resume runs/one" in capsys.readouterr().err
    assert main(["train", "--resume", "runs/one"]) == 0
    assert load_checkpoint(folder / "runs/one/final_ckpt.pt")["global_step"] == 16


def test_a_run_that_began_with_the_weights_of_another_can_be_resumed(folder):
    """Its record named their checkpoint, which --resume took for the wish to begin a new run."""
    assert main(TINY) == 0
    assert main([*TINY, "--exp_name", "two", "--checkpoint", "runs/one/final_ckpt.pt"]) == 0
    assert main(["train", "--resume", "runs/two", "--total_timesteps", "24"]) == 0
    assert load_checkpoint(folder / "runs/two/final_ckpt.pt")["global_step"] == 24
