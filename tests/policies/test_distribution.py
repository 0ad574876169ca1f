"""The action distribution against torch.distributions."""

import math

import pytest
import torch
from torch.distributions import Bernoulli, Independent, Normal, kl_divergence

from maniskill_grpd.policies import ActionDistribution


def make_distribution(seed=0, mask=None):
    rng = torch.Generator().manual_seed(seed)
    mean = torch.randn(5, 3, 3, generator=rng, dtype=torch.float64)
    std = torch.rand(5, 3, 1, generator=rng, dtype=torch.float64) + 0.1
    mask = torch.ones(5, 3, dtype=torch.bool) if mask is None else mask
    return ActionDistribution(mean, std, mask)


def reference(distribution):
    """One Gaussian per actuator."""
    return Independent(Normal(distribution.mean, distribution.std.expand(-1, -1, 3)), 1)


MASK = torch.tensor([[True, True, False]]).expand(5, 3)


@pytest.mark.parametrize("mask", [None, MASK], ids=["full", "masked"])
def test_log_prob_and_entropy_match_torch(mask):
    """Sums over unmasked actuators of what torch gives."""
    ours = make_distribution(mask=mask)
    action = torch.randn(5, 3, 3, dtype=torch.float64)
    weight = ours.mask.double()
    expected = (reference(ours).log_prob(action) * weight).sum(-1)
    torch.testing.assert_close(ours.log_prob(action), expected)
    torch.testing.assert_close(ours.log_prob(action.flatten(1)), expected)
    torch.testing.assert_close(ours.entropy(), (reference(ours).entropy() * weight).sum(-1))


@pytest.mark.parametrize("mask", [None, MASK], ids=["full", "masked"])
def test_parts_of_the_divergence_add_up_to_torch(mask):
    """Mean part with equal stds, covariance part with equal means, sum in general."""
    new, old = make_distribution(0, mask), make_distribution(1, mask)
    mean_part, covariance_part, _ = new.kl_parts(old)
    expected = kl_divergence(reference(new), reference(old)) * new.mask
    torch.testing.assert_close(mean_part + covariance_part, expected)
    same_mean = ActionDistribution(old.mean, new.std, new.mask)
    torch.testing.assert_close(same_mean.kl_parts(old).mean, torch.zeros(5, 3).double())
    torch.testing.assert_close(same_mean.kl_parts(old).cov, covariance_part)


def test_divergence_from_itself_is_zero():
    old = with_grippers(0)
    assert all((part == 0).all() for part in old.kl_parts(old))


@pytest.mark.parametrize(("dtype", "tolerance"), [(torch.float32, 2e-3), (torch.float64, 1e-6)])
@pytest.mark.parametrize("change", [2.0**-10, 2.0**-13, 1.1e-6, 1.1e-8])
def test_small_divergences_keep_their_digits(change, dtype, tolerance):
    """KL of a relative change e of std is 3 e^2, of a change e of the logit p (1 - p) e^2 / 2; sums of larger terms lose both.

    Changes are powers of two where float32 has to keep them through the rounding of what they are added to, and none where sums
    of powers of two would be exact in float64; the next term of the series is of order e.
    """
    if change < 16 * torch.finfo(dtype).eps:
        pytest.skip("less than this type resolves")
    logits = torch.full((1, 1), 0.25, dtype=dtype)
    old = ActionDistribution(
        torch.zeros(1, 1, 3, dtype=dtype), torch.full((1, 1, 1), 0.5, dtype=dtype), torch.ones(1, 1) > 0, logits
    )
    parts = ActionDistribution(old.mean, old.std * (1 + change), old.mask, logits + change).kl_parts(old)
    assert parts.cov.item() == pytest.approx(3 * change**2, rel=2 * change + tolerance, abs=0.0)
    p = 1 / (1 + math.exp(-0.25))
    if dtype == torch.float64 and change > 1e-5:
        assert parts.gripper.item() == pytest.approx(0.5 * p * (1 - p) * change**2, rel=2 * change + 1e-4, abs=0.0)


def test_the_divergence_is_from_the_old_policy_not_to_it():
    """KL(N(0, 2^2) || N(0, 1)) of three axes is 3/2 (4 - 1 - log 4); the other way round 3/2 (1/4 - 1 + log 4)."""
    mask, logit = torch.ones(1, 1) > 0, torch.zeros(1, 1)
    new = ActionDistribution(torch.ones(1, 1, 3), torch.full((1, 1, 1), 2.0), mask, logit + 3.0)
    old = ActionDistribution(torch.zeros(1, 1, 3), torch.ones(1, 1, 1), mask, logit)
    parts = new.kl_parts(old)
    assert parts.mean.item() == pytest.approx(1.5)
    assert parts.cov.item() == pytest.approx(1.5 * (3.0 - math.log(4.0)))
    p = 1 / (1 + math.exp(-3.0))
    assert parts.gripper.item() == pytest.approx(p * math.log(2 * p) + (1 - p) * math.log(2 * (1 - p)), rel=1e-5)


@pytest.mark.parametrize("length", [0.5, 2.0])
def test_spherical_entropies_are_those_of_samples(length):
    """Length and direction of 20,000 samples with a small deviation: their own deviations give the entropies."""
    count, std = 20_000, 0.02
    mean = torch.tensor([[[0.0, 0.0, length]]]).expand(count, 1, 3)
    ours = ActionDistribution(mean, torch.full((count, 1, 1), std), torch.ones(count, 1) > 0)
    sample = ours.sample(torch.Generator().manual_seed(0))
    radial = sample.norm(dim=-1).std().log().item() + 0.5 * math.log(2 * math.pi * math.e)
    angles = (sample / sample.norm(dim=-1, keepdim=True))[:, :2]
    angular = angles.std(dim=0).log().sum().item() + math.log(2 * math.pi * math.e)
    found = ours.spherical_entropies()
    assert found[0][0].item() == pytest.approx(radial, abs=0.03)
    assert found[1][0].item() == pytest.approx(angular, abs=0.03)
    resting = ActionDistribution(torch.zeros(1, 1, 3), torch.ones(1, 1, 1), torch.ones(1, 1) > 0)
    assert resting.spherical_entropies()[1].item() == pytest.approx(math.log(4 * math.pi))


def test_map_and_detach_reach_every_tensor():
    whole = with_grippers(0)
    whole.mean.requires_grad_()
    whole.gripper_logits.requires_grad_()
    assert {name for name, _ in whole.items()} == {"mean", "std", "mask", "gripper_logits"}
    assert not any(tensor.requires_grad for _, tensor in whole.detach().items())
    first = whole.map(lambda tensor: tensor[:1])
    assert all(torch.equal(tensor, dict(whole.items())[name][:1]) for name, tensor in first.items())
    assert make_distribution(0).map(torch.clone).gripper_logits is None


def test_samples_have_the_stated_moments():
    """Mean within five standard errors, std within 5 %, over 20,000 samples."""
    count = 20_000
    ours = ActionDistribution(
        torch.tensor([[[1.0, -2.0, 0.5]]]).expand(count, 1, 3),
        torch.full((count, 1, 1), 0.3),
        torch.ones(count, 1, dtype=torch.bool),
    )
    sample = ours.sample(torch.Generator().manual_seed(0))
    assert sample.shape == (count, 3)
    error = (sample.mean(0) - torch.tensor([1.0, -2.0, 0.5])).abs()
    assert (error < 5 * 0.3 / count**0.5).all()
    torch.testing.assert_close(sample.std(0), torch.full((3,), 0.3), rtol=0.05, atol=0.0)


def test_samples_follow_the_generator_and_carry_no_gradient():
    ours = make_distribution(mask=MASK)
    ours.mean.requires_grad_()
    first, second = (ours.sample(torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(first, second)
    assert not first.requires_grad
    assert (first.view(5, 3, 3)[:, 2] == 0).all()
    assert (ours.mode.view(5, 3, 3)[:, 2] == 0).all()


def with_grippers(seed=0, mask=None, scale=2.0):
    """A joint distribution of displacements and grippers."""
    gaussian = make_distribution(seed, mask)
    rng = torch.Generator().manual_seed(seed + 100)
    logits = scale * torch.randn(5, 3, generator=rng, dtype=torch.float64)
    return ActionDistribution(gaussian.mean, gaussian.std, gaussian.mask, logits)


@pytest.mark.parametrize("mask", [None, MASK], ids=["full", "masked"])
def test_joint_with_grippers_matches_torch(mask):
    """Log-probability, entropy and divergence are those of Gaussian times Bernoulli."""
    new, old = with_grippers(0, mask), with_grippers(1, mask)
    coin, old_coin = (Bernoulli(logits=d.gripper_logits) for d in (new, old))
    action = torch.randn(5, 3, 4, dtype=torch.float64)
    action[..., 3] = (action[..., 3] > 0).double()
    weight = new.mask.double()
    log_prob = reference(new).log_prob(action[..., :3]) + coin.log_prob(action[..., 3])
    torch.testing.assert_close(new.log_prob(action), (log_prob * weight).sum(-1))
    torch.testing.assert_close(new.log_prob(action.flatten(1)), (log_prob * weight).sum(-1))
    entropy = reference(new).entropy() + coin.entropy()
    torch.testing.assert_close(new.entropy(), (entropy * weight).sum(-1))
    gripper = kl_divergence(coin, old_coin) * weight
    torch.testing.assert_close(new.kl_parts(old).gripper, gripper)
    whole = kl_divergence(reference(new), reference(old)) * weight + gripper
    torch.testing.assert_close(new.kl_parts(old).total, whole.sum(-1))


def test_gripper_divergence_is_exact_when_small_and_finite_when_certain():
    """KL of a change e of the logit is p (1 - p) e^2 / 2; at logits of 100 nothing overflows."""
    one = torch.ones(1, 1, 1)

    def gripper(logit):
        logits = torch.full((1, 1), logit, requires_grad=True)
        return ActionDistribution(torch.zeros(1, 1, 3), one, one[..., 0] > 0, logits)

    small = gripper(0.301).kl_parts(gripper(0.3)).gripper
    p = torch.sigmoid(torch.tensor(0.3))
    torch.testing.assert_close(small.detach()[0, 0], p * (1 - p) * 5e-7, rtol=5e-3, atol=0.0)
    for pair in ((100.0, -100.0), (-100.0, 100.0), (100.0, 100.0)):
        new, old = (gripper(logit) for logit in pair)
        kl = new.kl_parts(old).gripper
        expected = 100.0 if pair[0] != pair[1] else 0.0  # log(1 / sigmoid(-100))
        torch.testing.assert_close(kl.detach(), torch.full((1, 1), expected))
        action = torch.tensor([[0.0, 0.0, 0.0, 1.0]])
        total = kl.sum() + new.entropy().sum() + new.log_prob(action).sum()
        total.backward()
        assert torch.isfinite(total)
        assert torch.isfinite(new.gripper_logits.grad).all()


def test_gripper_samples_have_the_stated_probability():
    """Within five standard errors over 20,000 samples; masked grippers stay at zero."""
    count = 20_000
    logits = torch.tensor([[-1.0, 2.0]]).expand(count, 2)
    mask = torch.tensor([[True, False]]).expand(count, 2)
    ours = ActionDistribution(torch.zeros(count, 2, 3), torch.ones(count, 2, 1), mask, logits)
    closed = ours.sample(torch.Generator().manual_seed(0)).view(count, 2, 4)[..., 3]
    p = float(torch.sigmoid(torch.tensor(-1.0)))
    assert abs(float(closed[:, 0].mean()) - p) < 5 * (p * (1 - p) / count) ** 0.5
    assert (closed[:, 1] == 0).all()
    assert (ours.mode.view(count, 2, 4)[:, 1] == 0).all()


def test_without_grippers_the_gripper_divergence_is_zero():
    new, old = make_distribution(0), make_distribution(1)
    parts = new.kl_parts(old)
    assert (parts.gripper == 0).all()
    torch.testing.assert_close(parts.total, (parts.mean + parts.cov).sum(-1))
