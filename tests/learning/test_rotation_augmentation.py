"""Turned transitions are what the turned scene would have given."""

import dataclasses

import pytest
import torch
from random_graphs import SCHEMA, make_graph
from test_update import CONFIG, collect, make_learner
from toy_env import ToyPolicy

from maniskill_grpd.learning import TrainConfig
from maniskill_grpd.learning.rollout import Batch
from maniskill_grpd.learning.rotation_augmentation import random_rotations, rotate_batch
from maniskill_grpd.policies import make_policy

COUNT = 6


def generator():
    return torch.Generator().manual_seed(0)


def batch_of(policy):
    """Return transitions that an old policy, slightly another one, collected."""
    torch.manual_seed(1)
    graph = make_graph(COUNT)
    with torch.no_grad():
        old = policy.distribution(graph)
        actions = old.sample()
        numbers = torch.randn(COUNT)
        return Batch(graph=graph, actions=actions, log_probs=old.log_prob(actions), old=old, advantages=numbers, returns=numbers)


@pytest.mark.parametrize("augmentation", ["vertical", "full"])
def test_rotations_are_proper(augmentation):
    rotations = random_rotations(500, augmentation, generator()).double()
    identity = torch.eye(3, dtype=torch.float64).expand(500, 3, 3)
    torch.testing.assert_close(rotations @ rotations.mT, identity, atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(500, dtype=torch.float64), atol=1e-5, rtol=0)
    # Over all of them every direction that moves is as likely as its opposite.
    average = rotations.mean(0)
    fixed = torch.tensor([0.0, 0.0, 1.0 if augmentation == "vertical" else 0.0], dtype=torch.float64)
    torch.testing.assert_close(average[:, 2], fixed, atol=0.1, rtol=0)
    assert average[:, :2].abs().max() < 0.1


@torch.no_grad()
@pytest.mark.parametrize("augmentation", ["vertical", "full"])
@pytest.mark.parametrize("gripper", [False, True])
def test_an_equivariant_policy_sees_nothing_new(augmentation, gripper):
    """Densities, divergences and values stay to rounding, of a policy that has changed since; of another policy they do not."""
    changes = {}
    for name in ("grpd", "hetero_gnn"):
        torch.manual_seed(0)
        policy = make_policy(name, SCHEMA, gripper=gripper)
        batch = batch_of(policy)
        for parameter in policy.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
        turned = rotate_batch(batch, random_rotations(COUNT, augmentation, generator()))
        (before, value), (after, turned_value) = policy(batch.graph), policy(turned.graph)
        changes[name] = [
            (after.log_prob(turned.actions) - before.log_prob(batch.actions)).abs().max(),
            (after.kl_parts(turned.old).total - before.kl_parts(batch.old).total).abs().max(),
            (turned_value - value).abs().max(),
        ]
    assert max(changes["grpd"]) < 2e-4
    assert min(changes["hetero_gnn"]) > 1e-3


@torch.no_grad()
@pytest.mark.parametrize("left", ["actions", "old", "gravity", "vectors"])
def test_what_is_left_behind_is_seen(left):
    """The control: with any part of the transition not turned an equivariant policy gives another density or divergence."""
    policy = make_policy("grpd", SCHEMA)
    for parameter in policy.parameters():
        parameter += 0.1 * torch.randn(parameter.shape, generator=generator())
    batch = batch_of(policy)
    batch = dataclasses.replace(batch, old=dataclasses.replace(batch.old, mean=batch.old.mean + 0.3))
    turned = rotate_batch(batch, random_rotations(COUNT, "full", generator()))
    if left in ("actions", "old"):
        turned = dataclasses.replace(turned, **{left: getattr(batch, left)})
    elif left == "gravity":
        turned.graph["gravity"] = batch.graph["gravity"]
    else:
        turned.graph["object"]["vectors"] = batch.graph["object"]["vectors"]
    before, after = policy.distribution(batch.graph), policy.distribution(turned.graph)
    changes = [
        (after.log_prob(turned.actions) - before.log_prob(batch.actions)).abs().max(),
        (after.kl_parts(turned.old).total - before.kl_parts(batch.old).total).abs().max(),
    ]
    assert max(changes) > 1e-3


@pytest.mark.parametrize("augmentation", ["none", "vertical"])
def test_minibatches_are_turned_where_it_is_asked_for(augmentation):
    config = dataclasses.replace(CONFIG, rotation_augmentation=augmentation)
    policy = ToyPolicy()
    learner, (rollout, _) = make_learner(policy, config), collect(policy)
    plain = {tuple(row.tolist()) for row in rollout.whole().actions}
    seen = [tuple(row.tolist()) for batch in learner.minibatches(rollout) for row in batch.actions]
    assert len(seen) == len(rollout.whole().actions)
    assert plain.issuperset(seen) == (augmentation == "none")


def test_the_natural_gradient_refuses_it():
    with pytest.raises(ValueError, match="leave out --rotation_augmentation"):
        TrainConfig(trust_region="fisher", rotation_augmentation="full")
