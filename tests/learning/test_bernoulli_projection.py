"""The projection of a gripper's Bernoulli variable against its definition and brute force."""

import pytest
import torch
from scipy.optimize import minimize_scalar

from maniskill_grpd.learning.bernoulli_projection import project_bernoulli
from maniskill_grpd.policies.divergence import bernoulli_kl


def draw(count, scale, dtype=torch.float64, seed=0):
    """Draw new and old log-odds, from nearly equal to far apart."""
    rng = torch.Generator().manual_seed(seed)
    old = scale * torch.randn(count, generator=rng, dtype=torch.float64)
    size = 10 ** (4 * torch.rand(count, generator=rng, dtype=torch.float64) - 3)
    new = old + size * torch.randn(count, generator=rng, dtype=torch.float64)
    return new.to(dtype), old.to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("bound", [1e-6, 1e-3, 0.01, 1.0, 20.0])
@pytest.mark.parametrize("scale", [0.1, 3.0, 20.0])
def test_the_kl_stays_within_its_bound(scale, bound, dtype):
    new, old = draw(50_000, scale, dtype)
    projected = project_bernoulli(new, old, bound=bound)
    assert projected.dtype == dtype
    assert torch.isfinite(projected).all()
    assert bernoulli_kl(projected.double(), old.double()).max() <= bound * (1 + 1e-9)


def test_an_active_bound_is_used_up():
    new, old = draw(50_000, 2.0)
    active = bernoulli_kl(new, old) > 0.01
    kl = bernoulli_kl(project_bernoulli(new, old, bound=0.01), old)[active]
    assert active.sum() > 10_000
    torch.testing.assert_close(kl, torch.full_like(kl, 0.01), rtol=1e-5, atol=0)


def test_variables_inside_the_bound_are_returned_bitwise():
    new, old = draw(10_000, 2.0, torch.float32)
    projected = project_bernoulli(new, old, bound=0.01)
    inside = bernoulli_kl(new.double(), old.double()) <= 0.01
    assert inside.sum() > 1000
    assert torch.equal(projected[inside], new[inside])
    assert torch.equal(project_bernoulli(old, old, bound=0.01), old)


def test_projection_is_the_constrained_optimum_found_by_brute_force():
    """Of all variables within the bound, none is nearer to the new one in KL(projected || new)."""
    new, old = draw(20, 1.0, seed=3)
    projected = project_bernoulli(new, old, bound=0.05)
    for target, center, found in zip(new, old, projected, strict=True):

        def distance(logit, target=target, center=center):
            logit = torch.tensor(logit, dtype=torch.float64)
            excess = (bernoulli_kl(logit, center) - 0.05).clamp_min(0.0)
            return (bernoulli_kl(logit, target) + 1e6 * excess).item()

        low, high = sorted((center.item(), target.item()))
        best = minimize_scalar(distance, bounds=(low, high), method="bounded", options={"xatol": 1e-9})
        assert found.item() == pytest.approx(best.x, abs=1e-4)


def test_gradient_flows_inside_the_bound_only():
    old = torch.zeros(2, dtype=torch.float64)
    new = torch.tensor([0.01, 5.0], dtype=torch.float64, requires_grad=True)
    gradient = torch.autograd.grad(project_bernoulli(new, old, bound=0.01).sum(), new)[0]
    assert gradient.tolist() == [1.0, 0.0]


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_bounds_are_refused(bound):
    with pytest.raises(ValueError, match="bound must be positive and finite"):
        project_bernoulli(torch.zeros(2), torch.zeros(2), bound=bound)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="share a shape"):
        project_bernoulli(torch.zeros(2), torch.zeros(3), bound=0.1)
