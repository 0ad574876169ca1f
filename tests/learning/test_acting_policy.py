"""The policy that acts next is inside the trust region, whatever the update did."""

import copy
import dataclasses

import pytest
import torch
from test_update import CONFIG, collect, make_learner
from toy_env import ToyEnv, ToyPolicy

from maniskill_grpd.learning import TrainConfig, Trainer
from maniskill_grpd.learning.acting_policy import PolicySnapshot, confine, measure_acting_kl

RUN = TrainConfig(
    num_envs=8,
    num_steps=10,
    num_minibatches=2,
    total_timesteps=8 * 10 * 6,
    eval_freq=0,
    learning_rate=0.02,
    trust_region_coef=1.0,  # with such steps and so weak a regression the region is left
    mean_bound=0.02,
    cov_bound=0.002,
    gripper_bound=0.002,
)


def acting_kls(tmp_path, config, gripper=False):
    """Train; return by iteration KL(new || old) of whole actions at the rollout's states, from copies of whole policies."""
    policy = ToyPolicy(gripper=gripper)
    trainer = Trainer(config, policy, ToyEnv(8, gripper=gripper), None, tmp_path)
    trainer.prepare()
    divergences = []
    while trainer.state.iteration < config.num_iterations:
        old = copy.deepcopy(policy)
        trainer.run_iteration()
        graph = trainer._collector.rollout.flat_graph()
        with torch.no_grad():
            divergences.append(policy.distribution(graph).kl_parts(old.distribution(graph)).total)
    trainer.close()
    return divergences


@pytest.mark.parametrize("gripper", [False, True])
@pytest.mark.parametrize("trust_region", ["projection", "lagrangian", "fisher"])
def test_the_average_kl_of_the_acting_policy_keeps_delta_in_every_iteration(trust_region, gripper, tmp_path):
    """Weights, shared layers that the value loss moves, and scales of observations included."""
    delta = 0.022 + 0.002 * gripper
    config = dataclasses.replace(RUN, trust_region=trust_region)
    for divergence in acting_kls(tmp_path, config, gripper):
        assert 0.0 < divergence.mean() <= delta * (1 + 1e-5)


def test_without_delta_the_same_training_leaves_the_region(tmp_path):
    """What the test above would see if nothing held the policy back."""
    free = acting_kls(tmp_path, dataclasses.replace(RUN, delta=1e9))
    assert max(divergence.mean() for divergence in free) > 3 * 0.022


def moved_policy(distance):
    """Return a policy, its learner, a rollout of it and a snapshot, after the weights have moved."""
    policy = ToyPolicy()
    rollout, _ = collect(policy)
    before = PolicySnapshot.of(policy)
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(distance * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(1)))
    return policy, make_learner(policy), rollout, before


def test_a_policy_inside_stays_bitwise():
    policy, learner, rollout, before = moved_policy(1e-4)
    moved = copy.deepcopy(policy.state_dict())
    metrics = confine(learner, rollout, before, 0.01)
    assert metrics["step_share"] == 1.0
    torch.testing.assert_close(policy.state_dict(), moved, rtol=0, atol=0)


@pytest.mark.parametrize("distance", [0.1, 1.0, 10.0])
@pytest.mark.parametrize("per_actuator", [False, True])
def test_a_policy_outside_comes_back_along_the_line_and_no_further_than_needed(distance, per_actuator):
    policy, learner, rollout, before = moved_policy(distance)
    after = {name: tensor.clone() for name, tensor in policy.state_dict().items()}
    metrics = confine(learner, rollout, before, 0.01, per_actuator=per_actuator)
    kl = measure_acting_kl(learner, rollout)
    bounded = kl.per_actuator if per_actuator else kl.mean
    assert 0.009 <= bounded <= 0.01
    assert (metrics["kl_acting"], metrics["kl_acting_p99"]) == (kl.mean, kl.p99)
    share = metrics["step_share"]
    for name, tensor in policy.state_dict().items():
        if tensor.is_floating_point():
            expected = before.tensors[name] + share * (after[name] - before.tensors[name])
            torch.testing.assert_close(tensor, expected, rtol=1e-5, atol=1e-6)


def test_the_percentile_is_over_states():
    policy, learner, rollout, _ = moved_policy(0.3)
    batch = rollout.whole()
    totals = policy.distribution(batch.graph).kl_parts(batch.old).total.detach()
    kl = measure_acting_kl(learner, rollout)
    assert len(totals) == CONFIG.batch_size
    assert kl.mean == pytest.approx(totals.mean().item(), rel=1e-5)
    assert kl.p99 == pytest.approx(torch.quantile(totals, 0.99).item(), rel=1e-5)
    assert kl.per_actuator == pytest.approx(kl.mean / 2, rel=1e-6)


def test_ppo_is_measured_and_not_held_back(tmp_path):
    config = dataclasses.replace(RUN, algorithm="ppo", clip_coef=0.9)
    assert max(divergence.mean() for divergence in acting_kls(tmp_path, config)) > 0.022
