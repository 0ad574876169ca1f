"""The fingerprint of a task changes with what the task does, and with nothing else."""

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.fingerprint import describe_task
from maniskill_grpd.tasks import RopeShapingEnv

TASK = TrainConfig(env_kwargs=("resolution=20", "num_grippers=2", "num_threads=1"), sim_backend="cpu")


@pytest.fixture(scope="module")
def fingerprint():
    return describe_task(TASK)["fingerprint"]


def test_a_task_that_does_the_same_has_the_same_fingerprint(fingerprint):
    assert describe_task(TASK) == {"progress": {"name": "mean_distance", "unit": "m"}, "fingerprint": fingerprint}


def test_a_change_of_a_reward_in_its_last_bits_is_seen(fingerprint, monkeypatch):
    reward = RopeShapingEnv.compute_normalized_dense_reward
    monkeypatch.setattr(RopeShapingEnv, "compute_normalized_dense_reward", lambda *args, **kw: reward(*args, **kw) * 1.000001)
    assert describe_task(TASK)["fingerprint"] != fingerprint


def test_a_heavier_rope_is_seen(fingerprint):
    heavy = TrainConfig(env_kwargs=(*TASK.env_kwargs, 'material={"mass": 1.0001}'), sim_backend="cpu")
    assert describe_task(heavy)["fingerprint"] != fingerprint
