"""Directed Gaussians against torch's multivariate normal, under rotations, and where a mean has no direction."""

import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.distributions import MultivariateNormal, kl_divergence

from maniskill_grpd.policies import ActionDistribution
from maniskill_grpd.policies.directed_gaussian import spread


def draw(seed=0, rows=50, dtype=torch.float64):
    """Means of length about 1 and deviations from 0.05 to 1.5 along and across them."""
    rng = torch.Generator().manual_seed(seed)
    mean = torch.randn(rows, 3, 3, generator=rng, dtype=torch.float64)
    std = 0.05 * 30 ** torch.rand(rows, 3, 2, generator=rng, dtype=torch.float64)
    mask = torch.rand(rows, 3, generator=rng) < 0.8
    return ActionDistribution(mean.to(dtype), std.to(dtype), mask)


def reference(dist):
    """The same Gaussians with L written out as the module's docstring has it."""
    along, across = dist.std.split(1, dim=-1)
    outer = dist.mean[..., None] * dist.mean[..., None, :] / (dist.mean.square().sum(-1)[..., None, None] + 0.05**2)
    factor = across[..., None] * torch.eye(3, dtype=torch.float64) + (along - across)[..., None] * outer
    return MultivariateNormal(dist.mean, covariance_matrix=factor @ factor.mT)


def rotated(dist, rotation):
    return ActionDistribution(dist.mean @ rotation.T, dist.std, dist.mask)


ROTATION = torch.from_numpy(Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())


def test_density_entropy_and_divergence_match_torch():
    new, old = draw(0), draw(1)
    new = ActionDistribution(new.mean, new.std, old.mask)
    action = torch.randn(50, 3, 3, dtype=torch.float64)
    weight = new.mask.double()
    torch.testing.assert_close(new.log_prob(action), (reference(new).log_prob(action) * weight).sum(-1))
    torch.testing.assert_close(new.entropy(), (reference(new).entropy() * weight).sum(-1))
    parts = new.kl_parts(old)
    torch.testing.assert_close(parts.mean + parts.cov, kl_divergence(reference(new), reference(old)) * weight)


def test_samples_have_the_covariance():
    dist = draw(2, rows=1)
    wide = dist.map(lambda tensor: tensor.expand(200_000, *tensor.shape[1:]))
    samples = wide.sample(torch.Generator().manual_seed(0)).reshape(-1, 3, 3)
    for actuator in torch.arange(3)[dist.mask[0]]:
        expected = reference(dist).covariance_matrix[0, actuator]
        # Entries of a sample covariance have a deviation of at most sqrt(2 / n) of the largest variance: 0.3 %.
        torch.testing.assert_close(samples[:, actuator].T.cov(), expected, rtol=0.0, atol=0.015 * expected.max().item())


def test_equal_deviations_are_the_isotropic_gaussian():
    directed, other = draw(3), draw(4)
    same = [ActionDistribution(d.mean, d.std[..., :1].expand(-1, -1, 2), directed.mask) for d in (directed, other)]
    round_ones = [ActionDistribution(d.mean, d.std[..., :1], directed.mask) for d in (directed, other)]
    torch.testing.assert_close(same[0].kl_parts(same[1]).total, round_ones[0].kl_parts(round_ones[1]).total)
    torch.testing.assert_close(same[0].entropy(), round_ones[0].entropy())


def test_it_turns_with_the_scene():
    """Density, entropy and divergence do not change under a rotation; with deviations of the world's axes they would."""
    new, old = draw(5), draw(6)
    new = ActionDistribution(new.mean, new.std, old.mask)
    action = torch.randn(50, 3, 3, dtype=torch.float64)
    torch.testing.assert_close(rotated(new, ROTATION).log_prob(action @ ROTATION.T), new.log_prob(action))
    moved = rotated(new, ROTATION).kl_parts(rotated(old, ROTATION))
    torch.testing.assert_close(moved.cov, new.kl_parts(old).cov)
    axes = torch.diag_embed(torch.cat([new.std, new.std[..., :1]], dim=-1).square())
    fixed, turned = (MultivariateNormal(mean, covariance_matrix=axes) for mean in (new.mean, new.mean @ ROTATION.T))
    assert not torch.allclose(turned.log_prob(action @ ROTATION.T), fixed.log_prob(action))


def test_radial_and_angular_entropy_follow_their_own_deviation():
    dist = draw(7)
    radial, angular = dist.spherical_entropies()
    wider = ActionDistribution(dist.mean, dist.std * torch.tensor([2.0, 1.0]), dist.mask)
    far = dist.mask & (dist.mean.norm(dim=-1) > 1.0)
    wider_radial, wider_angular = wider.spherical_entropies()
    assert (wider_radial - radial)[far].min() > 0.68  # log 2 = 0.69, less the share of the mean's radius
    torch.testing.assert_close(wider_angular, angular)


@pytest.mark.parametrize("length", [0.0, 1e-8, 1e-3])
def test_a_mean_without_direction_is_no_exception(length):
    """Near zero the Gaussian is the one across the mean, and all gradients are finite."""
    mean = torch.tensor([[[length, 0.0, 0.0]]], requires_grad=True)
    std = torch.tensor([[[1.5, 0.1]]], requires_grad=True)
    dist = ActionDistribution(mean, std, torch.ones(1, 1, dtype=torch.bool))
    old = ActionDistribution(mean.detach() + 0.01, std.detach(), dist.mask)
    axes = spread(mean, std)
    torch.testing.assert_close(axes.along, axes.across, rtol=0.006, atol=0.0)
    total = dist.log_prob(torch.ones(1, 3)) + dist.entropy() + dist.kl_parts(old).total
    gradients = torch.autograd.grad(total.sum(), (mean, std))
    assert all(gradient.isfinite().all() for gradient in gradients)
