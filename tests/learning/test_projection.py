"""The trust-region projection against its definition, brute force and autograd."""

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

from maniskill_grpd.learning import project_gaussian
from maniskill_grpd.learning.projection import isotropic_std_ratios
from maniskill_grpd.policies.divergence import gaussian_kl_parts

BOUNDS = [(0.05, 0.005), (1e-4, 1e-6), (1.0, 0.7)]


def draw(rows, dim, std_dim, dtype=torch.float64, seed=0, low=-1.0, high=1.0):
    """Draw new and old Gaussians with std log-uniform in [10^low, 10^high]."""
    rng = torch.Generator().manual_seed(seed)
    means = torch.randn(2, rows, dim, generator=rng, dtype=torch.float64)
    stds = 10 ** (low + (high - low) * torch.rand(2, rows, std_dim, generator=rng, dtype=torch.float64))
    return means[0].to(dtype), stds[0].to(dtype), means[1].to(dtype), stds[1].to(dtype)


def kl_by_definition(mean, std, old_mean, old_std):
    """Eq. 63 term by term, with full diagonals."""
    std, old_std = std.expand_as(mean), old_std.expand_as(mean)
    ratio = (std / old_std).square()
    kl_mean = 0.5 * ((mean - old_mean) / old_std).square().sum(-1)
    return kl_mean, 0.5 * (ratio.sum(-1) - mean.shape[-1] - ratio.log().sum(-1))


@pytest.mark.parametrize(("mean_bound", "cov_bound"), BOUNDS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("isotropic", [True, False])
@pytest.mark.parametrize("dim", [1, 2, 3, 6, 16])
def test_kl_parts_stay_within_their_bounds(dim, isotropic, dtype, mean_bound, cov_bound):
    """Over std from 1e-4 to 1e2 the rounded result itself stays inside, also in float32.

    With all parameters 1.2 million pairs.
    """
    gaussians = draw(20_000, dim, 1 if isotropic else dim, dtype, low=-4, high=2)
    mean, std = project_gaussian(*gaussians, mean_bound=mean_bound, cov_bound=cov_bound)
    old = [tensor.double() for tensor in gaussians[2:]]
    kl_mean, kl_cov = gaussian_kl_parts(mean.double(), std.double(), *old)
    assert mean.dtype == std.dtype == dtype
    # What remains is the rounding of the KL that decides: a few ulps of it.
    tolerance = 1.0 + 16 * torch.finfo(dtype).eps + 1e-9
    assert kl_mean.max() <= mean_bound * tolerance
    assert kl_cov.max() <= cov_bound * tolerance


@pytest.mark.parametrize("std_dim", [1, 3])
def test_an_active_bound_is_met_exactly(std_dim):
    mean, std, old_mean, old_std = draw(500, 3, std_dim)
    raw = gaussian_kl_parts(mean, std, old_mean, old_std)
    projected = project_gaussian(mean, std, old_mean, old_std, mean_bound=0.05, cov_bound=0.005)
    bounded = gaussian_kl_parts(*projected, old_mean, old_std)
    for before, after, bound in zip(raw, bounded, (0.05, 0.005), strict=True):
        active = before > bound
        assert active.sum() > 100
        torch.testing.assert_close(after[active], torch.full_like(after[active], bound), rtol=1e-9, atol=0)


@pytest.mark.parametrize("std_dim", [1, 4])
def test_gaussians_inside_both_bounds_are_returned_bitwise(std_dim):
    mean, std, _, _ = draw(200, 4, std_dim, torch.float32)
    old_mean, old_std = mean + 1e-3 * std, std * 1.001
    projected = project_gaussian(mean, std, old_mean, old_std, mean_bound=0.05, cov_bound=0.005)
    assert torch.equal(projected[0], mean)
    assert torch.equal(projected[1], std)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("std_dim", [1, 3])
def test_projection_is_idempotent(std_dim, dtype):
    mean, std, old_mean, old_std = draw(500, 3, std_dim, dtype)
    once = project_gaussian(mean, std, old_mean, old_std, mean_bound=0.05, cov_bound=0.005)
    twice = project_gaussian(*once, old_mean, old_std, mean_bound=0.05, cov_bound=0.005)
    tolerance = 4 * torch.finfo(dtype).eps
    torch.testing.assert_close(twice[0], once[0], rtol=0, atol=tolerance)
    torch.testing.assert_close(twice[1], once[1], rtol=tolerance, atol=0)


@pytest.mark.parametrize("dim", [1, 2, 3, 5])
def test_projection_is_the_constrained_optimum_found_by_brute_force(dim):
    """The mean minimises the old Mahalanobis distance, the covariance KL(projected || new)."""
    gaussians = draw(6, dim, dim, seed=dim, low=-0.5, high=0.5)
    projected = project_gaussian(*gaussians, mean_bound=0.05, cov_bound=0.02)
    for row in range(6):
        best_mean, best_std = _brute_force(*(tensor[row].numpy() for tensor in gaussians), 0.05, 0.02)
        np.testing.assert_allclose(projected[0][row], best_mean, rtol=0, atol=2e-5)
        np.testing.assert_allclose(projected[1][row], best_std, rtol=2e-5)


def _brute_force(mean, std, old_mean, old_std, mean_bound, cov_bound):
    def mean_part(x, center):
        return 0.5 * np.sum(((x - center) / old_std) ** 2)

    def cov_part(log_x, other):
        log_ratio = 2 * (log_x - np.log(other))
        return 0.5 * np.sum(np.exp(log_ratio) - 1 - log_ratio)

    # Constraints scaled to order one, or SLSQP stops at its own tolerance.
    best_mean = _slsqp(lambda x: mean_part(x, mean), lambda x: 1 - mean_part(x, old_mean) / mean_bound, old_mean)
    best_log_std = _slsqp(lambda x: cov_part(x, std), lambda x: 1 - cov_part(x, old_std) / cov_bound, np.log(old_std))
    return best_mean, np.exp(best_log_std)


def _slsqp(objective, inequality, start):
    constraint = {"type": "ineq", "fun": inequality}
    result = minimize(objective, start, constraints=constraint, method="SLSQP", options={"ftol": 1e-13, "maxiter": 500})
    assert inequality(result.x) > -1e-7
    return result.x


@pytest.mark.parametrize("std_dim", [1, 3])
def test_gradients_match_finite_differences(std_dim):
    mean, std, old_mean, old_std = draw(8, 3, std_dim, seed=3, low=-0.3, high=0.3)
    mean[0], std[0] = old_mean[0], old_std[0]  # inactive, at the singular point of the square root
    mean.requires_grad_()
    std.requires_grad_()

    def project(mean, std):
        return project_gaussian(mean, std, old_mean, old_std, mean_bound=0.05, cov_bound=0.005)

    assert torch.autograd.gradcheck(project, (mean, std), eps=1e-6, atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("std_dim", [1, 3])
def test_old_equal_to_new_gives_zero_divergence_and_finite_gradients(std_dim):
    mean, std, _, _ = draw(10, 3, std_dim, torch.float32)
    mean.requires_grad_()
    std.requires_grad_()
    old = mean.detach(), std.detach()
    projected = project_gaussian(mean, std, *old, mean_bound=0.05, cov_bound=0.005)
    loss = sum(part.sum() for part in gaussian_kl_parts(mean, std, *[p.detach() for p in projected]))
    loss.backward()
    assert loss.item() == 0.0
    assert torch.equal(mean.grad, torch.zeros_like(mean))
    torch.testing.assert_close(std.grad, torch.zeros_like(std))


def test_isotropic_clamp_equals_the_diagonal_solution_with_equal_entries():
    mean, std, old_mean, old_std = draw(300, 3, 1)
    bounds = {"mean_bound": 0.05, "cov_bound": 0.005}
    clamped = project_gaussian(mean, std, old_mean, old_std, **bounds)[1]
    wide = std.expand(-1, 3), old_mean, old_std.expand(-1, 3)
    mixed = project_gaussian(mean, *wide, **bounds)[1]
    torch.testing.assert_close(clamped.expand(-1, 3), mixed, rtol=1e-10, atol=0)


def test_isotropic_projection_is_rotation_equivariant():
    mean, std, old_mean, old_std = draw(300, 3, 1)
    rotation = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    bounds = {"mean_bound": 0.05, "cov_bound": 0.005}
    turned_after = project_gaussian(mean, std, old_mean, old_std, **bounds)[0] @ rotation
    turned_before = project_gaussian(mean @ rotation, std, old_mean @ rotation, old_std, **bounds)[0]
    torch.testing.assert_close(turned_after, turned_before, rtol=0, atol=1e-13)


def test_anisotropic_projection_is_not_rotation_equivariant():
    """Negative control of the test above: world-axis variances single out directions."""
    mean, std, old_mean, old_std = draw(300, 3, 3)
    rotation = torch.linalg.qr(torch.randn(3, 3, dtype=torch.float64))[0]
    bounds = {"mean_bound": 0.05, "cov_bound": 0.005}
    turned_after = project_gaussian(mean, std, old_mean, old_std, **bounds)[0] @ rotation
    turned_before = project_gaussian(mean @ rotation, std, old_mean @ rotation, old_std, **bounds)[0]
    assert (turned_after - turned_before).abs().max() > 1e-2


@pytest.mark.parametrize("std_dim", [1, 3])
def test_kl_parts_follow_the_definition(std_dim):
    gaussians = draw(200, 3, std_dim)
    for part, expected in zip(gaussian_kl_parts(*gaussians), kl_by_definition(*gaussians), strict=True):
        torch.testing.assert_close(part, expected, rtol=1e-9, atol=1e-12)


def test_kl_parts_agree_with_torch_distributions():
    mean, std, old_mean, old_std = draw(50, 3, 3)
    new, old = torch.distributions.Normal(mean, std), torch.distributions.Normal(old_mean, old_std)
    expected = torch.distributions.kl_divergence(new, old).sum(-1)
    torch.testing.assert_close(sum(gaussian_kl_parts(mean, std, old_mean, old_std)), expected)


def test_the_bound_is_on_the_standard_deviation_not_the_variance():
    """D = 3, bound 1e-3: log std may move by -0.01837 or +0.01815 (known roots)."""
    low, high = isotropic_std_ratios(1e-3, 3)
    np.testing.assert_allclose([np.log(low), np.log(high)], [-0.01837, 0.01815], atol=5e-6)


@pytest.mark.parametrize("bound", [1e-12, 1e-9, 3e-7, 1e-6, 1e-4, 1e-2, 1.0, 30.0])
def test_isotropic_roots_solve_their_equation(bound):
    for ratio in isotropic_std_ratios(bound, 3):
        x = ratio**2 - 1.0
        # x - log(1 + x) by its series where the difference cancels
        kl = x**2 / 2 - x**3 / 3 + x**4 / 4 if abs(x) < 1e-3 else x - np.log1p(x)
        assert 1.5 * kl == pytest.approx(bound, rel=1e-6)


def test_extreme_ratios_in_one_gaussian_are_solved():
    """One axis 1e6 times smaller, one 1e6 times larger: the mixing weight is near 1e-13."""
    std = torch.tensor([[1e-4, 1.0, 1e2], [1e2, 1e-4, 1.0]], dtype=torch.float64)
    old_std = torch.tensor([[1e2, 1.0, 1e-4], [1e-4, 1e2, 1.0]], dtype=torch.float64)
    mean = torch.zeros(2, 3, dtype=torch.float64)
    projected = project_gaussian(mean, std, mean, old_std, mean_bound=1.0, cov_bound=0.005)[1]
    kl = gaussian_kl_parts(mean, projected, mean, old_std)[1]
    torch.testing.assert_close(kl, torch.full_like(kl, 0.005), rtol=1e-6, atol=0)


@pytest.mark.parametrize("bound", [0.0, -1.0, float("nan"), float("inf")])
@pytest.mark.parametrize("name", ["mean_bound", "cov_bound"])
def test_bad_bounds_are_refused_by_name(name, bound):
    mean, std = torch.zeros(2, 3), torch.ones(2, 1)
    bounds = {"mean_bound": 0.1, "cov_bound": 0.1, name: bound}
    with pytest.raises(ValueError, match=name):
        project_gaussian(mean, std, mean, std, **bounds)


@pytest.mark.parametrize(
    ("shapes", "message"),
    [
        (((2, 3), (2, 1), (2, 2), (2, 1)), "mean and old_mean"),
        (((2, 3), (2, 2), (2, 3), (2, 2)), r"std must be \(2, 3\) or \(2, 1\)"),
        (((2, 3), (2, 3), (2, 3), (2, 1)), "old_std"),
        (((2, 3), (1, 1), (2, 3), (1, 1)), "std must be"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(shapes, message):
    tensors = [torch.ones(shape) for shape in shapes]
    with pytest.raises(ValueError, match=message):
        project_gaussian(*tensors, mean_bound=0.1, cov_bound=0.1)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan")])
def test_standard_deviations_that_are_not_positive_are_refused(value):
    mean, std, bad = torch.zeros(2, 3), torch.ones(2, 1), torch.tensor([[1.0], [value]])
    with pytest.raises(ValueError, match="^std must be positive"):
        project_gaussian(mean, bad, mean, std, mean_bound=0.1, cov_bound=0.1)
    with pytest.raises(ValueError, match="^old_std must be positive"):
        project_gaussian(mean, std, mean, bad, mean_bound=0.1, cov_bound=0.1)
