"""Checkpoints whose entries are garbage are refused in one line that names the entry."""

import pytest
import torch
from random_graphs import SCHEMA

from maniskill_grpd.learning import CheckpointError, TrainConfig, save_checkpoint
from maniskill_grpd.policies import make_policy
from maniskill_grpd.runs.checkpoints import load_policy


@pytest.fixture(scope="module")
def contents():
    policy = make_policy("grpd", SCHEMA, scalar_dim=8)
    entries = {
        "policy": policy.config,
        "weights": policy.state_dict(),
        "train_config": TrainConfig().to_dict(),
        "iteration": 0,
        "global_step": 0,
        "best_score": None,
    }
    return {**entries, **{name: {} for name in ("optimizer", "algorithm", "value_scale", "generators")}}


def test_a_sound_checkpoint_gives_the_policy(contents, tmp_path):
    save_checkpoint(tmp_path / "a.pt", contents)
    policy, found = load_policy(tmp_path / "a.pt")
    torch.testing.assert_close(dict(policy.state_dict()), dict(contents["weights"]), rtol=0, atol=0)
    assert found["train_config"] == contents["train_config"]


@pytest.mark.parametrize(
    ("entry", "part", "value"),
    [
        ("policy", "name", "no_such_policy"),
        ("policy", "name", ["grpd"]),
        ("policy", "name", None),
        ("policy", "schema", "garbage"),
        ("policy", "schema", {}),
        ("policy", "schema", {"object": 1, "actuator": 2, "length_scale": "x", "edge_length": None}),
        ("policy", "options", {"scalar_dim": "wide"}),
        ("policy", "options", {"scalar_dim": -3}),
        ("policy", "options", [1, 2]),
        ("weights", "no.such.weight", torch.zeros(1)),
        ("weights", None, "garbage"),
        ("weights", None, torch.zeros(1, 2, 3, 4)),
        ("train_config", "num_envs", "two"),
        ("train_config", "num_envs", -1),
        ("train_config", "env_kwargs", ["garbage"]),
        ("train_config", "env_kwargs", 7),
        ("train_config", "no_such_option", 1),
    ],
    ids=str,
)
def test_garbage_is_named_with_its_entry(contents, tmp_path, entry, part, value):
    """It was a traceback: KeyError, TypeError, or torch's list of all weights."""
    part = part or next(iter(contents["weights"]))
    save_checkpoint(tmp_path / "a.pt", {**contents, entry: {**contents[entry], part: value}})
    with pytest.raises(CheckpointError, match=entry) as error:
        load_policy(tmp_path / "a.pt")
    assert len(str(error.value)) < 500
