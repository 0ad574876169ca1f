"""A checkpoint of another policy, option or schema is refused, naming both sides."""

import dataclasses

import pytest
import torch
from random_graphs import SCHEMA, make_graph

from maniskill_grpd.graphs import NodeSchema
from maniskill_grpd.learning.checkpoint import CheckpointError, restore_policy
from maniskill_grpd.policies import POLICIES, make_policy, policy_from_config


def contents(policy):
    return {"policy": policy.config, "weights": policy.state_dict()}


@pytest.mark.parametrize("name", sorted(POLICIES))
def test_checkpoint_fits_itself(name):
    policy = make_policy(name, SCHEMA, gripper=True)
    rebuilt = policy_from_config(policy.config)
    restore_policy(rebuilt, contents(policy))
    graph = make_graph()
    assert torch.equal(rebuilt.act(graph, deterministic=True), policy.act(graph, deterministic=True))


def test_another_policy_is_named():
    with pytest.raises(CheckpointError, match=r"name: .*'empn', here it is 'grpd'"):
        restore_policy(make_policy("grpd", SCHEMA), contents(make_policy("empn", SCHEMA)))


def test_another_option_is_named():
    stored = contents(make_policy("grpd", SCHEMA, scalar_dim=16))
    with pytest.raises(CheckpointError, match=r"scalar_dim: the checkpoint has 16, here it is 32"):
        restore_policy(make_policy("grpd", SCHEMA), stored)
    with pytest.raises(CheckpointError, match=r"gripper: the checkpoint has False, here it is True"):
        restore_policy(make_policy("grpd", SCHEMA, gripper=True), contents(make_policy("grpd", SCHEMA)))


def test_another_schema_is_named():
    """Length scales by their values, channels by their names."""
    longer = dataclasses.replace(SCHEMA, length_scale=1.6)
    with pytest.raises(CheckpointError, match=r"length_scale: the checkpoint has 1.6, here .* 0.8"):
        restore_policy(make_policy("grpd", SCHEMA), contents(make_policy("grpd", longer)))
    fewer = dataclasses.replace(SCHEMA, object=NodeSchema(SCHEMA.object.vectors[:1], SCHEMA.object.scalars))
    pattern = r"schema.object.vectors: the checkpoint has .*velocity.*, here .*goal_offset"
    with pytest.raises(CheckpointError, match=pattern):
        restore_policy(make_policy("grpd", SCHEMA), contents(make_policy("grpd", fewer)))


def test_observation_of_another_task_is_named():
    """The graph has one channel less than the policy's schema: both widths and the names."""
    graph = make_graph()
    graph["actuator"]["scalars"] = graph["actuator"]["scalars"][..., 1:]
    pattern = (
        r"actuator.scalars must have shape \(4, 3, 3\), got \(4, 3, 2\); "
        r"the schema has the channels goal_distance, arc, gripper_status"
    )
    with pytest.raises(ValueError, match=pattern):
        make_policy("empn", SCHEMA).act(graph)


def test_config_of_an_unknown_policy_lists_the_known():
    config = {**make_policy("grpd", SCHEMA).config, "name": "mlp"}
    with pytest.raises(ValueError, match=r"unknown policy 'mlp'; allowed are \['empn', 'grpd'"):
        policy_from_config(config)
