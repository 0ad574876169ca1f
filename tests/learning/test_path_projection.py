"""The projection of directed Gaussians: bounds kept, identity inside, on the border, equivariant, differentiable."""

import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.learning.path_projection import project_along_path
from maniskill_grpd.learning.trust_region import Bounds
from maniskill_grpd.policies import ActionDistribution

BOUNDS = Bounds(mean=0.1, cov=0.01, gripper=0.02)


def draw(rows=2_000, step=1.0, dtype=torch.float64, seed=0):
    """Old policies, and new ones that lie `step` times the deviation and the factor exp(step) away."""
    rng = torch.Generator().manual_seed(seed)

    def normal(*shape):
        return torch.randn(rows, 3, *shape, generator=rng, dtype=torch.float64)

    mask = torch.rand(rows, 3, generator=rng) < 0.8
    old = ActionDistribution(normal(3).to(dtype), torch.exp(0.5 * normal(2) - 1.0).to(dtype), mask)
    mean = old.mean + step * old.std.mean(-1, keepdim=True) * normal(3).to(dtype)
    return ActionDistribution(mean, old.std * torch.exp(step * normal(2)).to(dtype), mask), old


def projected(dist, old, bounds=BOUNDS):
    mean, std = project_along_path(dist, old, bounds)
    return ActionDistribution(mean, std, dist.mask)


def limited(dist, old, bounds):
    parts = bounds.limited(dist.kl_parts(old))
    return parts.mean, parts.cov


@pytest.mark.parametrize("per_actuator", [False, True])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_both_parts_keep_their_bounds_and_one_is_met(dtype, per_actuator):
    bounds = Bounds(mean=0.1, cov=0.01, gripper=0.02, per_actuator=per_actuator)
    dist, old = draw(dtype=dtype)
    mean_part, cov_part = limited(projected(dist, old, bounds), old, bounds)
    # The pair that was tried is the pair that comes back, so there is no rounding between them.
    assert mean_part.max() <= bounds.mean
    assert cov_part.max() <= bounds.cov
    raw_mean, raw_cov = limited(dist, old, bounds)
    outside = (raw_mean > bounds.mean) | (raw_cov > bounds.cov)
    assert outside.sum() > 1_000
    reached = torch.maximum(mean_part / bounds.mean, cov_part / bounds.cov)[outside]
    assert reached.min() > 1.0 - (1e-3 if dtype == torch.float32 else 1e-5)


def test_inside_nothing_changes():
    """Bit for bit, also where other states of the batch are outside."""
    near, old = draw(step=0.01)
    far, _ = draw(step=1.0)
    half = torch.arange(len(near.mask))[:, None, None] < len(near.mask) // 2
    dist = ActionDistribution(torch.where(half, near.mean, far.mean), torch.where(half, near.std, far.std), near.mask)
    result = projected(dist, old)
    inside = torch.stack(limited(dist, old, BOUNDS)).le(torch.tensor([0.1, 0.01])[:, None, None]).all(0).squeeze(-1)
    assert 500 < inside.sum() < 1_500
    assert torch.equal(result.mean[inside], dist.mean[inside])
    assert torch.equal(result.std[inside], dist.std[inside])


def test_it_commutes_with_rotations():
    dist, old = draw(rows=200)
    rotation = torch.from_numpy(Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix())
    moved = [ActionDistribution(d.mean @ rotation.T, d.std, d.mask) for d in (dist, old)]
    result, turned = projected(dist, old), projected(*moved)
    torch.testing.assert_close(turned.mean, result.mean @ rotation.T, rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(turned.std, result.std, rtol=1e-5, atol=1e-6)


def test_the_derivative_is_that_of_the_projection():
    """Against central differences of the projection, whose bisection leaves 1e-8 of noise: 1e-4 in a quotient over 2e-4."""
    dist, old = draw(rows=40)
    rng = torch.Generator().manual_seed(1)
    directions = [torch.randn(tensor.shape, generator=rng, dtype=torch.float64) for tensor in (dist.mean, dist.std)]
    weights = [torch.randn(tensor.shape, generator=rng, dtype=torch.float64) for tensor in (dist.mean, dist.std)]

    def value(step):
        moved = ActionDistribution(dist.mean + step * directions[0], dist.std * torch.exp(step * directions[1]), dist.mask)
        return sum((w * x).flatten(1).sum(1) for w, x in zip(weights, project_along_path(moved, old, BOUNDS), strict=True))

    step = torch.zeros(40, 1, 1, dtype=torch.float64, requires_grad=True)
    (derivative,) = torch.autograd.grad(value(step).sum(), step)
    differences = (value(1e-4) - value(-1e-4)).detach() / 2e-4
    error = (derivative.flatten() - differences).abs()
    # Where mean and covariance part change places as the one at its bound there is a kink.
    assert error.median() < 2e-3
    assert (error < 0.02).float().mean() > 0.9
