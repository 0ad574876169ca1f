"""The losses of BPP and PPO on numbers a person can check."""

import dataclasses
import math

import pytest
import torch

from maniskill_grpd.learning.bpp import BPP
from maniskill_grpd.learning.lagrangian import LagrangianBPP
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


def test_a_mean_outside_its_bound_leaves_a_std_inside_its_own_alone():
    """The policy is drawn to its projection, not the projection to the policy: without that, sigma would shrink or grow."""
    batch, old = make_batch()
    batch = dataclasses.replace(batch, advantages=torch.zeros_like(batch.advantages))
    dist = shifted(old, mean_shift=1.0)
    loss, metrics = losses(BPP(**BPP_OPTIONS), dist, batch)
    mean_gradient, std_gradient = torch.autograd.grad(loss, [dist.mean, dist.std])
    assert metrics["mean_bound_active"] == 1.0
    assert metrics["cov_bound_active"] == 0.0
    assert mean_gradient.abs().min() > 0.0
    assert std_gradient.abs().max() < 1e-6 * mean_gradient.abs().max()


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


def test_the_regression_on_the_projection_leaves_what_lies_inside_alone():
    """Means outside, deviations inside: the loss draws the means, and the deviations feel nothing of it.

    If the projection were not held fixed, wider deviations would make the distance of the means look smaller.
    """
    batch, old = make_batch()
    batch.advantages.zero_()
    for per_actuator in (False, True):
        algorithm = BPP(**{**BPP_OPTIONS, "bounds": dataclasses.replace(BOUNDS, per_actuator=per_actuator)})
        dist = shifted(old, mean_shift=1.0)
        loss, metrics = losses(algorithm, dist, batch)
        assert metrics["mean_bound_active"] == 1.0
        drawn, felt = torch.autograd.grad(loss, (dist.mean, dist.std))
        assert (drawn > 0).all()
        assert felt.abs().max() == 0.0


@pytest.mark.parametrize(
    "algorithm",
    [
        BPP(**BPP_OPTIONS),
        PPO(clip_coef=0.2, ent_coef=0.0),
        LagrangianBPP(bounds=BOUNDS, dual_step=0.5, max_multiplier=9.0, ent_coef=0.0),
    ],
    ids=lambda algorithm: type(algorithm).__name__,
)
def test_the_divergence_is_that_of_the_new_policy_from_the_old(algorithm):
    """Two actuators with twice the deviation: 3/2 (4 - 1 - log 4) each; the other way round it would be 3/2 (1/4 - 1 + log 4)."""
    batch, old = make_batch()
    _, metrics = losses(algorithm, shifted(old, std_factor=2.0), batch)
    assert metrics["kl_raw"].item() == pytest.approx(2 * 1.5 * (3.0 - math.log(4.0)), rel=1e-5)


def test_the_regression_measures_the_policy_from_its_projection():
    """With deviations far outside KL(pi || pi_p) and its reverse differ by a factor."""
    batch, old = make_batch()
    dist = shifted(old, std_factor=3.0)
    algorithm = BPP(**BPP_OPTIONS)
    projected = algorithm.project(dist, old)
    _, metrics = algorithm.policy_loss(dist, projected, batch)
    ratio = (dist.std / projected.std).square().detach()
    expected = (1.5 * (ratio - 1.0 - ratio.log())).sum((1, 2)).mean()
    torch.testing.assert_close(metrics["trust_region_loss"], expected, rtol=1e-4, atol=0)


def joint_kl(dist, old, mask):
    """KL of whole actions by eq. 63, actuators that exist only: mean and covariance part, (M,)."""
    q = (dist.std / old.std).square().squeeze(-1)
    mean = 0.5 * ((dist.mean - old.mean) / old.std).square().sum(-1)
    return ((mean * mask).sum(-1), (1.5 * (q - 1.0 - q.log()) * mask).sum(-1))


def test_the_joint_bound_is_one_for_all_actuators():
    """Sums over actuators meet the bound where it is active, one actuator may use up all of it, masked ones count nothing."""
    batch, old = make_batch(size=200, num_actuators=3)
    mask = torch.tensor([True, True, False]).expand(200, 3)
    generator = torch.Generator().manual_seed(5)
    mean = old.mean + 0.3 * torch.randn(200, 3, 3, generator=generator) * torch.tensor([1.0, 0.1, 5.0])[:, None]
    std = old.std * torch.exp(0.3 * torch.randn(200, 3, 1, generator=generator) * torch.tensor([1.0, 0.1, 5.0])[:, None])
    dist, old = ActionDistribution(mean, std, mask), ActionDistribution(old.mean, old.std, mask)
    raw = joint_kl(dist, old, mask)
    projected = BPP(**BPP_OPTIONS).project(dist, old)
    for before, after, bound in zip(raw, joint_kl(projected, old, mask), (0.05, 0.005), strict=True):
        active = before > bound
        assert 20 < active.sum() < 200
        torch.testing.assert_close(after[active], torch.full_like(after[active], bound), rtol=2e-3, atol=0)
        torch.testing.assert_close(after[~active], before[~active])
    step = (projected.mean - old.mean) / (dist.mean - old.mean)  # one factor for all actuators of a state
    torch.testing.assert_close(step[:, 0], step[:, 1], rtol=1e-2, atol=1e-2)
