"""Checkpoints survive full disks and say what is wrong with a file."""

import errno
import os

import pytest
import torch
from toy_env import ToyPolicy
from toy_run import make_toy_trainer

from maniskill_grpd.learning import CheckpointError, TrainConfig, load_checkpoint, save_checkpoint
from maniskill_grpd.learning.checkpoint import restore_policy


def contents(iteration=1, policy=None):
    policy = policy or ToyPolicy()
    return {
        "policy": policy.config,
        "weights": policy.state_dict(),
        "optimizer": torch.optim.Adam(policy.parameters()).state_dict(),
        "algorithm": {"multipliers": {"mean": 1.0}},
        "value_scale": {"weight": 0.0, "mean": 0.0, "mean_square": 0.0},
        "generators": {"action": torch.Generator().get_state()},
        "train_config": TrainConfig().to_dict(),
        "iteration": iteration,
        "global_step": 100 * iteration,
        "best_score": None,
    }


def test_round_trip(tmp_path):
    saved = contents()
    save_checkpoint(tmp_path / "a.pt", saved)
    loaded = load_checkpoint(tmp_path / "a.pt")
    assert set(loaded) == set(saved)
    assert loaded["train_config"] == saved["train_config"]
    torch.testing.assert_close(loaded["weights"], saved["weights"], rtol=0, atol=0)
    assert os.listdir(tmp_path) == ["a.pt"]


def test_missing_entries_are_refused_when_saving(tmp_path):
    with pytest.raises(ValueError, match="best_score"):
        save_checkpoint(tmp_path / "a.pt", {"weights": {}})


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match="no checkpoint at"):
        load_checkpoint(tmp_path / "none.pt")


@pytest.mark.parametrize("kept", [0.0, 0.01, 0.5, 0.99])
def test_truncated_file(tmp_path, kept):
    path = tmp_path / "a.pt"
    save_checkpoint(path, contents())
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * kept)])
    with pytest.raises(CheckpointError, match="truncated or not a checkpoint"):
        load_checkpoint(path)


@pytest.mark.parametrize("content", [b"not a checkpoint", b"hello\n", b"\x80\x02}q\x00.", bytes(100)])
def test_files_of_other_formats(tmp_path, content):
    (tmp_path / "other.pt").write_bytes(content)
    with pytest.raises(CheckpointError, match="not a checkpoint of this package"):
        load_checkpoint(tmp_path / "other.pt")


def test_checkpoints_of_other_programs(tmp_path):
    torch.save(ToyPolicy().state_dict(), tmp_path / "weights.pt")
    with pytest.raises(CheckpointError, match="another program"):
        load_checkpoint(tmp_path / "weights.pt")


class Payload:
    """Runs when unpickled carelessly."""

    def __reduce__(self):
        return os.mkdir, ("executed",)


def test_nothing_in_a_file_is_executed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    torch.save({"format": Payload()}, tmp_path / "evil.pt")
    with pytest.raises(CheckpointError):
        load_checkpoint(tmp_path / "evil.pt")
    assert not (tmp_path / "executed").exists()


def test_other_version(tmp_path, monkeypatch):
    monkeypatch.setattr("maniskill_grpd.learning.checkpoint.VERSION", 99)
    save_checkpoint(tmp_path / "a.pt", contents())
    monkeypatch.undo()
    with pytest.raises(CheckpointError, match="version 99"):
        load_checkpoint(tmp_path / "a.pt")


def test_a_policy_with_other_options_is_refused_by_name(tmp_path):
    save_checkpoint(tmp_path / "a.pt", contents(policy=ToyPolicy(hidden_dim=8)))
    loaded = load_checkpoint(tmp_path / "a.pt")
    with pytest.raises(CheckpointError, match=r"options.hidden_dim: the checkpoint has 8, here it is 16"):
        restore_policy(ToyPolicy(hidden_dim=16), loaded)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_a_full_disk_leaves_the_old_checkpoint(tmp_path):
    path = tmp_path / "a.pt"
    save_checkpoint(path, contents(iteration=1))
    os.symlink("/dev/full", tmp_path / f".a.pt.{os.getpid()}.tmp")
    with pytest.raises(OSError, match="cannot write checkpoint .*previous one is intact") as error:
        save_checkpoint(path, contents(iteration=2))
    assert error.value.errno == errno.ENOSPC
    assert load_checkpoint(path)["iteration"] == 1
    assert os.listdir(tmp_path) == ["a.pt"]


def test_a_failed_sync_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "a.pt"
    save_checkpoint(path, contents(iteration=1))

    def fail(descriptor):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(OSError, match="Input/output error"):
        save_checkpoint(path, contents(iteration=2))
    assert load_checkpoint(path)["iteration"] == 1
    assert os.listdir(tmp_path) == ["a.pt"]


def test_a_missing_folder_is_an_os_error(tmp_path):
    with pytest.raises(OSError, match="nothing was written"):
        save_checkpoint(tmp_path / "none" / "a.pt", contents())


GARBAGE = {
    "none": None,
    "number": 7,
    "negative": -1,
    "text": "garbage",
    "list": ["a", "b"],
    "names": {"garbage": 1},
    "numbers": {1: {2: 3}},
    "tensor": torch.full((3,), 1e9),
}
SOUND = {("iteration", "number"), ("global_step", "number"), ("best_score", "none")}


@pytest.mark.parametrize("garbage", GARBAGE)
@pytest.mark.parametrize("entry", sorted(contents()))
def test_an_entry_that_is_garbage_is_named(tmp_path, entry, garbage):
    """They ended in tracebacks: KeyError, TypeError, AttributeError, some of them in the first step of training."""
    trainer = make_toy_trainer(tmp_path)
    save_checkpoint(tmp_path / "a.pt", {**trainer.state.to_checkpoint(), entry: GARBAGE[garbage]})
    if (entry, garbage) in SOUND:
        trainer.load(tmp_path / "a.pt")
        return
    with pytest.raises(CheckpointError, match=f"{entry}|options|fit this policy|process"):
        trainer.load(tmp_path / "a.pt")


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("weights", "encoder.0.weight"), torch.zeros(2, 2)),
        (("weights", "encoder.0.weight"), "garbage"),
        (("weights", "encoder.0.weight"), torch.nan),
        (("optimizer", "param_groups"), []),
        (("optimizer", "param_groups"), [{"lr": 1.0}]),
        (("optimizer", "state", 0, "exp_avg"), torch.zeros(1)),
        (("optimizer", "state", 0, "exp_avg_sq"), "garbage"),
        (("value_scale", "mean"), float("nan")),
        (("value_scale", "mean"), "garbage"),
        (("generators", "action"), torch.zeros(3, dtype=torch.uint8)),
        (("generators", "action"), torch.zeros(3)),
        (("generators", "action"), "garbage"),
        (("best_score",), ["a", "b"]),
    ],
    ids=str,
)
def test_garbage_within_an_entry_is_named(tmp_path, path, value):
    make_toy_trainer(tmp_path).train()
    saved = load_checkpoint(tmp_path / "last.pt")
    place = saved
    for key in path[:-1]:
        place = place[key]
    name = path[-1] if path[0] != "weights" else next(iter(place))
    place[name] = torch.full_like(place[name], value) if isinstance(value, float) and path[0] == "weights" else value
    save_checkpoint(tmp_path / "a.pt", saved)
    with pytest.raises(CheckpointError, match=path[0]):
        make_toy_trainer(tmp_path).load(tmp_path / "a.pt")
