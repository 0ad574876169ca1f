"""Training that clones demonstrations first."""

from pathlib import Path

import pytest
import torch

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import train
from maniskill_grpd.imitation import demonstrations as demonstrations_module
from maniskill_grpd.imitation.recording import RecordConfig, record
from maniskill_grpd.imitation.regression import relative_error
from maniskill_grpd.learning.run_log import read_rows
from maniskill_grpd.policies import policy_from_config
from maniskill_grpd.runs.checkpoints import load_policy

SIZES = "--num_envs 4 --num_steps 5 --num_minibatches 2 --update_epochs 1 --eval_freq 0 --total_timesteps 20 --no-capture_video"
ROPE = ("resolution=20", "graph_nodes=6", "max_episode_steps=12")
CLOTH = ("resolution=49", "graph_nodes=8", "release=true", "max_episode_steps=6")


def recorded(folder, env_id, env_kwargs):
    config = RecordConfig(
        env_id=env_id, env_kwargs=env_kwargs, num_episodes=4, num_envs=4, output=folder, keep_failures=True, sim_backend="cpu"
    )
    return record(config)[0]


def words(env_id, env_kwargs, path, *more):
    return ["--env_id", env_id, "--env_kwargs", *env_kwargs, *SIZES.split(), "--demonstrations", str(path), *more]


@pytest.fixture(scope="module")
def rope_file(tmp_path_factory):
    return recorded(tmp_path_factory.mktemp("demos"), "RopeShaping-v1", ROPE)


@pytest.mark.parametrize(("env_id", "env_kwargs"), [("RopeShaping-v1", ROPE), ("ClothHanging-v1", CLOTH)])
@pytest.mark.parametrize("policy", ["grpd", "hetero_gnn"])
def test_training_goes_on_from_what_was_cloned(env_id, env_kwargs, policy, tmp_path, monkeypatch, capsys):
    """With a learning rate of nothing the trained policy is the cloned one: its actions, its scales, its small deviation."""
    monkeypatch.chdir(tmp_path)
    path = recorded(tmp_path / "demos", env_id, env_kwargs)
    more = ["--learning_rate", "1e-12", "--normalizer_freeze_steps", "0", "--exp_name", "warm", "--policy", policy]
    assert train.main(words(env_id, env_kwargs, path, *more)) == 0
    assert "cloned 4 episodes" in capsys.readouterr().out
    trained, contents = load_policy("runs/warm/final_ckpt.pt")
    has_grippers = contents["policy"]["options"]["gripper"]
    shown = demonstrations_module.load_demonstrations(path, trained.schema, has_grippers=has_grippers)
    everything = torch.arange(len(shown.episode))
    fresh = policy_from_config(contents["policy"])
    fresh.normalizer.load_state_dict(trained.normalizer.state_dict())
    assert has_grippers == (env_id == "ClothHanging-v1")
    assert relative_error(trained, shown, everything) < 0.9 * relative_error(fresh, shown, everything)
    assert 0.03 < trained.distribution(shown.graph).std.mean().item() < 0.07
    scales = policy_from_config(contents["policy"]).normalizer
    scales.update(shown.select(shown.split(1, torch.Generator().manual_seed(1))[0])[0])
    for name, value in scales.state_dict().items():
        torch.testing.assert_close(trained.normalizer.state_dict()[name], value, rtol=0, atol=0, msg=name)
    assert contents["policy"]["options"]["init_std"] == 0.05
    assert contents["train_config"]["noise_correlation"] == 0.0  # ClothHanging-v1 recommends another


@pytest.mark.parametrize(
    ("env_id", "env_kwargs", "message"),
    [
        ("RopeWrapping-v1", ROPE, "recorded with task RopeShaping-v1, this training has RopeWrapping-v1"),
        ("RopeShaping-v1", (*ROPE, "grasp=free"), "recorded with control mode pd_ee_delta_pos, this training has"),
        ("RopeShaping-v1", (*ROPE, "graph_features=rich"), "recorded with graph_features paper, this training has rich"),
    ],
)
def test_demonstrations_of_something_else_are_refused(env_id, env_kwargs, message, rope_file, tmp_path, monkeypatch, capsys):
    """Before the first step, with what to do about it, and without a record of a run."""
    monkeypatch.chdir(tmp_path)
    assert train.main(words(env_id, env_kwargs, rope_file, "--exp_name", "wrong")) == 1
    error = capsys.readouterr().err
    assert message in error
    assert "--env_id RopeShaping-v1" in error
    assert not (tmp_path / "runs/wrong/config.json").exists()


def test_values_are_the_returns_of_the_demonstrations(rope_file, tmp_path, monkeypatch):
    """With a learning rate of nothing the trained values stay near the returns to go, with and without an episode's end."""
    shown = demonstrations_module.Demonstrations(
        graph={}, actions=torch.zeros(3, 1, 3), episode=torch.tensor([0, 0, 1]), rewards=torch.tensor([1.0, 2.0, 3.0])
    )
    assert shown.returns(0.5).tolist() == [1.0 + 0.5 * 4.0, 4.0, 6.0]  # 2 + 2/2 + 2/4 + ... = 4
    assert shown.returns(1.0).tolist() == [3.0, 2.0, 3.0]
    monkeypatch.chdir(tmp_path)
    still = ["--learning_rate", "1e-12", "--normalizer_freeze_steps", "0", "--exp_name", "warm", "--gamma", "0.9"]
    assert train.main(words("RopeShaping-v1", ROPE, rope_file, *still)) == 0
    policy, _ = load_policy("runs/warm/final_ckpt.pt")
    recorded = demonstrations_module.load_demonstrations(rope_file, policy.schema)
    correlation = torch.corrcoef(torch.stack([policy.value(recorded.graph).detach(), recorded.returns(0.9)]))[0, 1]
    assert correlation > 0.3  # after a dozen gradient steps


def test_the_log_begins_with_what_was_cloned(rope_file, tmp_path, monkeypatch):
    """The first evaluation is at step 0 and is of the policy before any update; one that was not taught has none there."""
    monkeypatch.chdir(tmp_path)
    evaluated = ["--eval_freq", "1", "--num_eval_envs", "3"]
    still = ["--learning_rate", "1e-12", "--normalizer_freeze_steps", "0"]
    assert train.main([*words("RopeShaping-v1", ROPE, rope_file, "--exp_name", "warm", *still), *evaluated]) == 0
    fresh = ["--env_id", "RopeShaping-v1", "--env_kwargs", *ROPE, *SIZES.split(), "--exp_name", "fresh", *evaluated]
    assert train.main(fresh) == 0
    warm, fresh = (read_rows(Path("runs") / name / "metrics.jsonl", "eval") for name in ("warm", "fresh"))
    assert [row["global_step"] for row in warm] == [0, 20]
    assert warm[0]["eval/return"] == pytest.approx(warm[1]["eval/return"], rel=1e-3)
    assert [row["global_step"] for row in fresh] == [20]


def test_what_cannot_be_meant_is_refused(rope_file, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert train.main(words("RopeShaping-v1", ROPE, tmp_path / "none.h5")) == 1
    assert "none.h5 is missing" in capsys.readouterr().err
    assert train.main(words("RopeShaping-v1", ROPE, rope_file, "--checkpoint", "some.pt")) != 0
    assert "give one of them" in capsys.readouterr().err
