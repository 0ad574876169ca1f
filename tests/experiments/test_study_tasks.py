"""Every task accepts what the studies ask of it."""

import pytest

pytest.importorskip("mani_skill")


from maniskill_grpd.experiments import STUDIES
from maniskill_grpd.experiments.study import to_pairs
from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.runs.environments import make_env

LARGEST = 400
"""Finer objects take long to build, and take the same options."""


def settings():
    """Return id and options of all tasks in training and under test, each once."""
    found = {}
    for task in (task for study in STUDIES.values() for task in study.tasks):
        for changed in ({}, *(condition.env_options for condition in task.conditions)):
            options = {**task.options, **changed}
            if options["resolution"] <= LARGEST:
                found[" ".join([task.env_id, *to_pairs(options)])] = (task.env_id, options)
    return found


@pytest.mark.parametrize(("env_id", "options"), settings().values(), ids=settings())
def test_a_setting_can_be_made_and_observed(env_id, options):
    env = make_env(TrainConfig(env_id=env_id, env_kwargs=to_pairs({**options, "num_threads": 1})), 1)
    graph = env.reset(seed=0)[0]["graph"]
    seen = graph["object"]["mask"].sum().item()
    if "visibility" in options:
        assert 0 < seen <= options.get("keypoints", options["graph_nodes"])
    elif options.get("graph_nodes") is not None:
        assert seen == options["graph_nodes"]
    else:
        assert seen == pytest.approx(options["resolution"], rel=0.1)
    assert graph["actuator"]["position"].shape[1] == options.get("num_grippers", env.unwrapped.num_grippers)
    env.close()
