"""The losses of BPP and PPO on numbers a person can check."""

import math

import pytest
import torch

from maniskill_grpd.learning.bpp import BPP
from maniskill_grpd.learning.ppo import PPO
from maniskill_grpd.learning.rollout import Batch
from maniskill_grpd.learning.trust_region import Bounds
from maniskill_grpd.policies import ActionDistribution

BOUNDS = Bounds(mean=0.05, cov=0.005, gripper=0.01)
BPP_OPTIONS = {"bounds": BOUNDS, "trust_region_coef": 1.0, "ent_coef": 0.0}


def losses(algorithm, dist, batch):
    """Return the loss and all metrics of a minibatch."""
    projected = algorithm.project(dist, batch.old)
    loss, metrics = algorithm.policy_loss(dist, projected, batch)
    return loss, {**metrics, **algorithm.diagnose(dist, projected, batch)}


def make_batch(size=32, num_actuators=2, seed=0):
    """Draw a batch whose log probabilities are those of its old distribution."""
    rng = torch.Generator().manual_seed(seed)
    mean = torch.randn(size, num_actuators, 3, generator=rng)
    std = 0.2 + torch.rand(size, num_actuators, 1, generator=rng)
    old = ActionDistribution(mean, std, torch.ones(size, num_actuators, dtype=torch.bool))
    actions = old.sample(rng)
    advantages = torch.randn(size, generator=rng)
    batch = Batch(graph={}, actions=actions, log_probs=old.log_prob(actions), old=old, advantages=advantages, returns=advantages)
    return batch, old


def shifted(old, mean_shift=0.0, std_factor=1.0, mask=None):
    """Return a differentiable distribution away from the old one."""
    mean = (old.mean + mean_shift).requires_grad_()
    std = (old.std * std_factor).requires_grad_()
    return ActionDistribution(mean, std, old.mask if mask is None else mask)


def test_bpp_at_the_old_policy_is_the_plain_policy_gradient():
    batch, old = make_batch()
    dist = shifted(old)
    loss, metrics = losses(BPP(**BPP_OPTIONS), dist, batch)
    assert metrics["trust_region_loss"] == 0.0
    assert metrics["kl_raw_max"] == metrics["kl_projected_max"] == 0.0
    assert metrics["mean_bound_active"] == metrics["cov_bound_active"] == 0.0
    torch.testing.assert_close(loss, -batch.advantages.mean())
    gradient = torch.autograd.grad(loss, dist.mean)[0]
    expected = torch.autograd.grad(-(dist.log_prob(batch.actions) * batch.advantages).mean(), dist.mean)[0]
    torch.testing.assert_close(gradient, expected)


def test_bpp_bounds_the_projected_policy_and_reports_the_raw_one():
    batch, old = make_batch()
    _, metrics = losses(BPP(**BPP_OPTIONS), shifted(old, mean_shift=1.0, std_factor=2.0), batch)
    assert metrics["kl_projected_max"] <= 2 * (0.05 + 0.005) * (1 + 1e-5)
    assert metrics["kl_projected_mean_part_max"] <= 0.05 * (1 + 1e-5)
    assert metrics["kl_projected_cov_part_max"] <= 0.005 * (1 + 1e-5)
    assert metrics["kl_raw"] > 1.0
    assert metrics["mean_bound_active"] == metrics["cov_bound_active"] == 1.0


def test_bpp_draws_a_clamped_std_back():
    """The clamp has no gradient of its own; the trust-region loss must supply it."""
    batch, old = make_batch()
    for factor, sign in ((2.0, 1.0), (0.5, -1.0)):
        dist = shifted(old, std_factor=factor)
        loss, _ = losses(BPP(**BPP_OPTIONS), dist, batch)
        gradient = torch.autograd.grad(loss, dist.std)[0]
        assert (gradient * sign > 0).all()


def test_masked_actuators_do_not_count_in_either_algorithm():
    batch, old = make_batch()
    mask = torch.tensor([True, False]).expand(32, 2)
    for algorithm in (BPP(**BPP_OPTIONS), PPO(clip_coef=0.2, ent_coef=0.1)):
        results = []
        for garbage in (0.0, 7.0):
            dist = shifted(old, mean_shift=0.3, mask=mask)
            mean = dist.mean + garbage * torch.tensor([0.0, 1.0]).reshape(1, 2, 1)
            results.append(losses(algorithm, ActionDistribution(mean, dist.std, mask), batch))
        (loss, metrics), (other_loss, other_metrics) = results
        torch.testing.assert_close(loss, other_loss)
        assert metrics.keys() == other_metrics.keys()
        for name, value in metrics.items():
            torch.testing.assert_close(value, other_metrics[name])


@pytest.mark.parametrize(
    ("ratio", "advantage", "expected"),
    [
        (1.0, 1.0, -1.0),
        (1.5, 1.0, -1.2),  # gain clipped
        (0.5, 1.0, -0.5),  # loss not clipped
        (1.5, -1.0, 1.5),  # loss not clipped
        (0.5, -1.0, 0.8),  # gain clipped
    ],
)
def test_ppo_clips_gains_only(ratio, advantage, expected):
    batch, old = make_batch(size=1)
    batch.advantages.fill_(advantage)
    batch.log_probs.sub_(math.log(ratio))
    loss, metrics = losses(PPO(clip_coef=0.2, ent_coef=0.0), shifted(old), batch)
    assert loss.item() == pytest.approx(expected, rel=1e-5)
    assert metrics["clipfrac"] == (ratio != 1.0)


def test_entropy_bonus_raises_the_std():
    batch, old = make_batch()
    batch.advantages.zero_()
    options = {**BPP_OPTIONS, "ent_coef": 0.1}
    for algorithm in (BPP(**options), PPO(clip_coef=0.2, ent_coef=0.1)):
        dist = shifted(old)
        loss, _ = losses(algorithm, dist, batch)
        assert (torch.autograd.grad(loss, dist.std)[0] < 0).all()
