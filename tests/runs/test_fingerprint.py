"""The fingerprint of a run changes with what its task does and how it learns, and with nothing else."""

import dataclasses

import pytest
import torch

pytest.importorskip("mani_skill")

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.ppo import PPO
from maniskill_grpd.runs.fingerprint import describe_task, describe_training
from maniskill_grpd.tasks import RopeShapingEnv

TASK = TrainConfig(env_kwargs=("resolution=20", "num_grippers=2", "num_threads=1"), sim_backend="cpu", algorithm="ppo")


@pytest.fixture(scope="module")
def fingerprint():
    return describe_training(TASK)["fingerprint"]


def changes(config, fingerprint):
    """Return which parts are not as they were."""
    found = describe_training(config)["fingerprint"]
    return {part for part in fingerprint if found[part] != fingerprint[part]}


def test_what_does_the_same_has_the_same_fingerprint(fingerprint):
    other = dataclasses.replace(TASK, seed=5, num_envs=8, total_timesteps=50_000, exp_name="other", torch_threads=2)
    assert changes(other, fingerprint) == set()
    without = {part: value for part, value in fingerprint.items() if part != "learner"}
    assert describe_task(TASK) == {"progress": {"name": "mean_distance", "unit": "m"}, "fingerprint": without}


def test_teams_of_agents_do_what_one_agent_does(fingerprint):
    pair = 'robot_uids=["floating_grippers_1", "floating_grippers_1"]'
    assert changes(dataclasses.replace(TASK, env_kwargs=("resolution=20", pair, "num_threads=1")), fingerprint) == set()


def test_taking_a_fingerprint_leaves_the_random_numbers_of_the_run():
    torch.manual_seed(3)
    expected = torch.rand(4)
    torch.manual_seed(3)
    describe_training(TASK)
    assert torch.equal(torch.rand(4), expected)


def test_a_change_of_a_reward_in_its_last_bits_is_seen(fingerprint, monkeypatch):
    reward = RopeShapingEnv.compute_normalized_dense_reward
    monkeypatch.setattr(RopeShapingEnv, "compute_normalized_dense_reward", lambda *args, **kw: reward(*args, **kw) * 1.000001)
    assert "task" in changes(TASK, fingerprint)


def test_a_heavier_rope_is_seen_in_the_solver(fingerprint):
    heavy = dataclasses.replace(TASK, env_kwargs=(*TASK.env_kwargs, 'material={"mass": 1.0001}'))
    assert {"solver", "task"} <= changes(heavy, fingerprint)


@pytest.mark.parametrize(
    "options", [{"learning_rate": 4e-4}, {"gamma": 0.95}, {"policy": "transformer"}, {"algorithm": "bpp"}, {"num_steps": 50}]
)
def test_how_it_learns_is_seen_in_the_learner_alone(options, fingerprint):
    expected = set() if "num_steps" in options else {"learner"}
    assert changes(dataclasses.replace(TASK, **options), fingerprint) == expected


def test_a_change_of_a_loss_is_seen_in_the_learner(fingerprint, monkeypatch):
    loss = PPO.policy_loss
    monkeypatch.setattr(PPO, "policy_loss", lambda *args: (1.0001 * loss(*args)[0], loss(*args)[1]))
    assert changes(TASK, fingerprint) == {"learner"}
