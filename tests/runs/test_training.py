"""Runs that are started twice, and runs that were stopped early."""

import json
import signal

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.learning import collector, load_checkpoint
from maniskill_grpd.learning.rollout import Rollout
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


@pytest.mark.parametrize("hidden", [["keypoints=4"], ["visibility=camera", "hidden_nodes=stale"]])
def test_a_critic_that_sees_all_is_of_training_alone(hidden, folder, monkeypatch):
    made = []

    class Recorded(Rollout):
        def store_graph(self, step, graph):
            made.append(graph)
            super().store_graph(step, graph)

    monkeypatch.setattr(collector, "Rollout", Recorded)
    assert main([*TINY, *hidden, "--critic_observations", "full", "--eval_freq", "1", "--num_eval_envs", "2"]) == 0
    nodes = made[-1]["critic"]["object"]["mask"]
    assert nodes.all()
    assert nodes.shape[1] == 20
    assert main(["evaluate", "--checkpoint", "runs/one/final_ckpt.pt", "--num_episodes", "2", "--num_envs", "2"]) == 0
    assert main([*TINY, "--exp_name", "two", "--critic_observations", "full"]) == 1  # nothing is hidden


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_run_after_its_iteration_with_the_command_that_goes_on(number, folder, monkeypatch, capsys):
    """Ctrl-C lost what was trained since the last checkpoint; the other signals said nothing at all."""
    run_iteration = Trainer.run_iteration

    def signalled(self):
        signal.raise_signal(number)
        run_iteration(self)

    before = signal.signal(number, signal.SIG_DFL)  # a shell's background ignores Ctrl-C
    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "run_iteration", signalled)
        assert main(TINY) == 128 + number
    signal.signal(number, before)
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.endswith("checkpoint runs/one/last.pt; go on: maniskill-grpd train --resume runs/one")
    assert load_checkpoint(folder / "runs/one/last.pt")["global_step"] == 8
    assert main(["train", "--resume", "runs/one"]) == 0
    assert load_checkpoint(folder / "runs/one/final_ckpt.pt")["global_step"] == 16


@pytest.mark.parametrize("damage", [None, b"", b'{"config": {"seed', b"\xff\xfe", b'{"config": {"num_envs": "two"}}'])
def test_a_run_goes_on_from_its_checkpoint_whatever_became_of_its_record_and_log(damage, folder, capsys):
    """The checkpoint holds the options too; a damaged config.json cost the run."""
    assert main(TINY) == 0
    record, log = folder / "runs/one/config.json", folder / "runs/one/metrics.jsonl"
    before = json.loads(record.read_text())
    record.unlink() if damage is None else record.write_bytes(damage)
    log.write_bytes(b"garbage\n" + log.read_bytes())
    assert main(["train", "--resume", "runs/one", "--total_timesteps", "24"]) == 0
    output = capsys.readouterr().err
    assert "the options are those of runs/one/last.pt" in output
    assert "metrics.jsonl, line 1: damaged" in output
    assert load_checkpoint(folder / "runs/one/final_ckpt.pt")["global_step"] == 24
    after = json.loads(record.read_text())["config"]
    assert after == {**before["config"], "total_timesteps": 24, "resume": "runs/one"}
