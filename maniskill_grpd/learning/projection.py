"""Differentiable projection of a Gaussian policy onto a KL trust region (paper eq. 10, 59-65).

For each Gaussian the nearest one is returned that satisfies

    KL_mean(projected || old) <= mean_bound   and   KL_cov(projected || old) <= cov_bound.

Nearest means: covariances in KL(projected || new), means in the metric of the old covariance, which
is the same up to a factor where covariances are isotropic. The two parts of
KL(N(mean, std^2) || N(old_mean, old_std^2)), eq. 63, are

    KL_mean = 1/2 sum_i (mean_i - old_mean_i)^2 / old_std_i^2
    KL_cov  = 1/2 sum_i (lambda_i - 1 - log lambda_i),   lambda_i = std_i^2 / old_std_i^2.

The last dimension of `mean` is the action dimension d of one Gaussian; every leading dimension is a
batch. `std` has the same last dimension (diagonal covariance) or 1 (isotropic, sigma^2 I).
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from scipy.special import lambertw

from maniskill_grpd.policies.divergence import kl_cov, kl_mean

# The root search converges in about 8 steps; the cap only ends a search that rounding keeps alive.
_MAX_ROOT_STEPS = 60
# Relative accuracy of the root in float64, a few hundred ulps of the terms that are summed.
_ROOT_TOLERANCE = 1e-13
# The projected mean is pulled in by this many ulps so that rounding cannot leave the region.
_SHRINK_ULPS = 4


def project_gaussian(
    mean: torch.Tensor, std: torch.Tensor, old_mean: torch.Tensor, old_std: torch.Tensor, *, mean_bound: float, cov_bound: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Project Gaussians so that each KL part to the old Gaussians stays within its bound.

    Gaussians inside both bounds come back bitwise unchanged, so the projection is idempotent.
    The result is differentiable in `mean` and `std`. A clamped isotropic std has no gradient: the
    trust-region loss of BPP carries the signal there.

    Args:
        mean: New means, (..., d).
        std: New standard deviations (not variances), (..., d) or, for sigma^2 I, (..., 1).
        old_mean: Means of the behaviour policy, shape of `mean`.
        old_std: Standard deviations of the behaviour policy, shape of `std`.
        mean_bound: Largest mean part of KL(projected || old), > 0 [nats].
        cov_bound: Largest covariance part of KL(projected || old), > 0 [nats].

    Returns:
        Projected means (..., d) and standard deviations in the shape of `std`.

    Raises:
        ValueError: If a bound is not positive and finite, shapes do not fit, or a standard
            deviation is not positive.
    """
    _check_bound("mean_bound", mean_bound)
    _check_bound("cov_bound", cov_bound)
    _check_gaussians(mean, std, old_mean, old_std)
    return project_unchecked(mean, std, old_mean, old_std, mean_bound=mean_bound, cov_bound=cov_bound)


def project_unchecked(
    mean: torch.Tensor, std: torch.Tensor, old_mean: torch.Tensor, old_std: torch.Tensor, *, mean_bound: float, cov_bound: float
) -> tuple[torch.Tensor, torch.Tensor]:
    """Do the work of `project_gaussian`, whose checks each wait for the device."""
    projected_mean = _project_mean(mean, old_mean, old_std, mean_bound)
    if std.shape[-1] == 1:
        return projected_mean, _project_isotropic(std, old_std, mean.shape[-1], cov_bound)
    return projected_mean, _project_diagonal(std, old_std, cov_bound)


def project_joint(
    mean: torch.Tensor,
    std: torch.Tensor,
    old_mean: torch.Tensor,
    old_std: torch.Tensor,
    mask: torch.Tensor,
    *,
    mean_bound: float,
    cov_bound: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Project the joint Gaussian of several actuators so that the sums of their KL parts keep the bounds.

    The joint Gaussian of isotropic ones has a diagonal covariance: means step back by one factor for all actuators, precisions
    are mixed in one ratio for all, and the result is the nearest one as in `project_gaussian`.

    Args:
        mean: New means, (..., A, d).
        std: New standard deviations, (..., A, 1).
        old_mean: Shape of `mean`.
        old_std: Shape of `std`.
        mask: Which actuators exist, bool (..., A); the others count nothing and come back as the old ones.
        mean_bound: Largest sum over actuators of the mean part of KL(projected || old) [nats].
        cov_bound: Largest sum of the covariance part [nats].

    Returns:
        Projected means (..., A, d) and standard deviations (..., A, 1).
    """
    present, dim = mask.unsqueeze(-1), mean.shape[-1]
    mean, std = torch.where(present, mean, old_mean), torch.where(present, std, old_std)
    wide = old_std.expand_as(mean).flatten(-2)
    joint = _project_mean(mean.flatten(-2), old_mean.flatten(-2), wide, mean_bound)
    # Each of the d axes of an actuator has the same part.
    widths = _project_diagonal(std.squeeze(-1), old_std.squeeze(-1), cov_bound / dim)
    return joint.unflatten(-1, mean.shape[-2:]), widths.unsqueeze(-1)


@lru_cache(maxsize=64)
def isotropic_std_ratios(bound: float, dim: int) -> tuple[float, float]:
    """Return the smallest and largest std / old_std whose covariance KL is `bound`.

    The roots of lambda - 1 - log(lambda) = 2 bound / dim are lambda = -W(-exp(-1 - 2 bound / dim))
    on the branches 0 and -1 of the Lambert W function.

    Args:
        bound: Covariance part of the KL, > 0 [nats].
        dim: Action dimension d of one Gaussian.
    """
    excess = 2.0 * bound / dim
    if excess < 1e-6:  # W loses its digits at its branch point -1/e; use its series
        root = math.sqrt(2.0 * excess)  # series of the root of exp(x) - 1 - x = excess
        odd, even = root + root**3 / 36.0, -excess / 3.0
        return math.exp(0.5 * (even - odd)), math.exp(0.5 * (even + odd))
    argument = -math.exp(-1.0 - excess)
    small, large = -lambertw(argument, 0).real, -lambertw(argument, -1).real
    return math.sqrt(_polish_root(small, excess)), math.sqrt(_polish_root(large, excess))


def _polish_root(ratio: float, excess: float) -> float:
    """Return a root of x - 1 - log(x) = excess after two Newton steps from `ratio`."""
    for _ in range(2):
        ratio -= (ratio - 1.0 - math.log(ratio) - excess) / (1.0 - 1.0 / ratio)
    return ratio


def _project_mean(mean: torch.Tensor, old_mean: torch.Tensor, old_std: torch.Tensor, bound: float) -> torch.Tensor:
    """Scale the step old_mean -> mean back to the ellipsoid KL_mean = bound where it is outside."""
    step = mean - old_mean
    kl = 0.5 * (step / old_std).square().sum(-1, keepdim=True)
    active = kl > bound
    # Masking the input, not the output: sqrt at kl = 0 has an infinite gradient.
    shrink = 1.0 - _SHRINK_ULPS * torch.finfo(mean.dtype).eps
    scale = shrink * (bound / torch.where(active, kl, bound)).sqrt()
    projected = _round_inside(old_mean + scale * step, old_mean, lambda x: kl_mean(x, old_mean, old_std) > bound)
    return torch.where(active, projected, mean)


def _project_isotropic(std: torch.Tensor, old_std: torch.Tensor, dim: int, bound: float) -> torch.Tensor:
    """Clamp std / old_std to the two constant ratios at which KL_cov = bound (diagonal in closed form)."""
    low, high = isotropic_std_ratios(bound, dim)
    shrink = _SHRINK_ULPS * torch.finfo(std.dtype).eps
    return torch.clamp(std, min=old_std * min(low + shrink, 1.0), max=old_std * max(high - shrink, 1.0))


def _project_diagonal(std: torch.Tensor, old_std: torch.Tensor, bound: float) -> torch.Tensor:
    """Mix precisions, 1 / std^2 -> old and new in the ratio at which KL_cov = bound.

    With a_i = old_std_i^2 / std_i^2 - 1 the projected std is old_std_i / sqrt(1 + t a_i), t in
    (0, 1] the root of F (see `_mixing_residual`). Autograd through one Newton step from the root is
    exactly the implicit derivative dt/da. float64 inside: F is a difference of nearly equal terms.
    """
    active = (kl_cov(std, old_std, std.shape[-1]) > bound).unsqueeze(-1)
    if not active.any():
        return std
    old = old_std.double()
    # Inactive rows are replaced at the input: their F has no root and would give NaN gradients.
    new = torch.where(active, std.double(), 0.5 * old)
    change = (old - new) * (old + new) / new.square()  # a, without the cancellation of x - 1
    with torch.no_grad():
        weight = _mixing_root(change, bound)
        slope = _mixing_slope(weight, change).clamp_min(torch.finfo(torch.float64).tiny)
    weight = weight - _mixing_residual(weight, change, bound) / slope
    mixed = (old * torch.rsqrt(1.0 + weight * change)).to(std.dtype)
    mixed = _round_inside(mixed, old_std, lambda x: kl_cov(x, old_std, std.shape[-1]) > bound)
    return torch.where(active, mixed, std)


def _mixing_residual(weight: torch.Tensor, change: torch.Tensor, bound: float) -> torch.Tensor:
    """Return F(t) = KL_cov(t) - bound = 1/2 sum_i (1/p_i - 1 + log p_i) - bound, p = 1 + t a."""
    shift = weight * change
    # 1/p - 1 = -shift / p
    terms = torch.log1p(shift) - shift / (1.0 + shift)
    return 0.5 * terms.sum(-1, keepdim=True) - bound


def _mixing_slope(weight: torch.Tensor, change: torch.Tensor) -> torch.Tensor:
    """Return F'(t) = 1/2 t sum_i a_i^2 / p_i^2."""
    return 0.5 * weight * (change / (1.0 + weight * change)).square().sum(-1, keepdim=True)


def _mixing_root(change: torch.Tensor, bound: float) -> torch.Tensor:
    """Find the root t of F by Newton's method, bisecting where a step leaves the bracket.

    F <= t^2 sum_i a_i^2 - bound for t <= 1/2, so the first `low` has F <= 0; F(1) > 0. The middle of
    a bracket is its geometric mean: with std 1e6 times smaller than before the root is near 1e-13.
    """
    low = (bound / change.square().sum(-1, keepdim=True)).sqrt().clamp_max(0.5)
    high = torch.ones_like(low)
    weight = (2.0 * low).clamp_max(1.0)
    for _ in range(_MAX_ROOT_STEPS):
        residual = _mixing_residual(weight, change, bound)
        if (residual.abs() <= _ROOT_TOLERANCE * max(bound, 1e-3)).all():
            break
        low = torch.where(residual < 0, weight, low)
        high = torch.where(residual > 0, weight, high)
        newton = weight - residual / _mixing_slope(weight, change)
        inside = (newton > low) & (newton < high)
        weight = torch.where(inside, newton, (low * high).sqrt())
    return weight


def _round_inside(value: torch.Tensor, old: torch.Tensor, is_outside) -> torch.Tensor:
    """Move each value one float towards `old` in the rows that rounding left outside the region.

    A float32 mean of 1 with a std of 1e-4 has a spacing of 1e-3 std: rounding to the nearest float
    would break the bound visibly. The gradient is that of `value`.
    """
    exact = value.detach()
    correction = torch.nextafter(exact, old) - exact
    return value + torch.where(is_outside(exact).unsqueeze(-1), correction, 0.0)


def _check_bound(name: str, bound: float) -> None:
    if not (math.isfinite(bound) and bound > 0.0):
        raise ValueError(f"{name} must be positive and finite, got {bound}")


def _check_gaussians(mean: torch.Tensor, std: torch.Tensor, old_mean: torch.Tensor, old_std: torch.Tensor) -> None:
    if mean.ndim == 0 or old_mean.shape != mean.shape:
        raise ValueError(f"mean and old_mean must share a shape (..., d), got {tuple(mean.shape)} and {tuple(old_mean.shape)}")
    if std.shape not in (mean.shape, (*mean.shape[:-1], 1)):
        raise ValueError(f"std must be {tuple(mean.shape)} or {(*mean.shape[:-1], 1)} to go with mean, got {tuple(std.shape)}")
    if old_std.shape != std.shape:
        raise ValueError(f"old_std must have the shape of std, {tuple(std.shape)}, got {tuple(old_std.shape)}")
    for name, value in (("std", std), ("old_std", old_std)):
        if not (value > 0).all():
            raise ValueError(f"{name} must be positive, its smallest entry is {value.min().item()}")
