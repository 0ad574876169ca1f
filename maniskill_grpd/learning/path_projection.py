"""Differentiable projection of directed Gaussians onto a KL trust region, along the path from the old policy to the new one.

The covariance of a directed Gaussian turns with its mean (`policies.directed_gaussian`), so that mean and covariance cannot be
projected one after the other, as `projection` does for isotropic ones. They go back together instead:

    mean(t) = mean_old + t (mean - mean_old),    log std(t) = log std_old + t (log std - log std_old),    0 <= t <= 1

with the largest t found at which both parts of KL(pi(t) || pi_old), eq. 63, keep their bounds.

Limitations: the result is inside the region and, where one part is at its bound, on its border, but not the nearest point of it.
"""

from __future__ import annotations

import dataclasses

import torch

from maniskill_grpd.learning.trust_region import Bounds
from maniskill_grpd.policies import ActionDistribution

# Halvings of the interval in which t lies: more than the digits of float32.
_HALVINGS = 26


def project_along_path(dist: ActionDistribution, old: ActionDistribution, bounds: Bounds) -> tuple[torch.Tensor, torch.Tensor]:
    """Take directed Gaussians back until the mean and the covariance part of their KL keep the bounds.

    Where they keep them they come back bitwise unchanged.

    Args:
        dist: New policy at M states, differentiable, std (M, A, 2).
        old: Old policy there.
        bounds: Of the mean and of the covariance part, of whole actions or of each actuator.

    Returns:
        Means (M, A, 3) and standard deviations (M, A, 2).
    """
    with torch.no_grad():
        share = _largest_share(dist, old, bounds)
    active = share < 1.0
    if not active.any():
        return dist.mean, dist.std
    share = torch.where(active, _with_gradient(share, dist, old, bounds), 1.0)
    mean, std = _at(share, dist, old)
    return torch.where(active[..., None], mean, dist.mean), torch.where(active[..., None], std, dist.std)


def _at(share: torch.Tensor, dist: ActionDistribution, old: ActionDistribution) -> tuple[torch.Tensor, torch.Tensor]:
    """Return mean and std at shares (M, A) or (M, 1) of the path."""
    share = share[..., None]
    return old.mean + share * (dist.mean - old.mean), old.std * (dist.std / old.std) ** share


def _excess(share: torch.Tensor, dist: ActionDistribution, old: ActionDistribution, bounds: Bounds) -> torch.Tensor:
    """Return the larger part of the KL over its bound, less one, at shares of the path: (M, A) or (M, 1)."""
    mean, std = _at(share, dist, old)
    parts = bounds.limited(dataclasses.replace(dist, mean=mean, std=std).kl_parts(old))
    return torch.maximum(parts.mean / bounds.mean, parts.cov / bounds.cov) - 1.0


def _largest_share(dist: ActionDistribution, old: ActionDistribution, bounds: Bounds) -> torch.Tensor:
    """Find shares without excess by bisection: what it returns was tried and is inside."""
    high = dist.mean.new_ones(dist.mask.shape if bounds.per_actuator else (len(dist.mask), 1))
    inside = _excess(high, dist, old, bounds) <= 0.0
    low = torch.where(inside, high, 0.0)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        inside = _excess(middle, dist, old, bounds) <= 0.0
        low, high = torch.where(inside, middle, low), torch.where(inside, high, middle)
    return low


def _with_gradient(share: torch.Tensor, dist: ActionDistribution, old: ActionDistribution, bounds: Bounds) -> torch.Tensor:
    """Return the shares t with their implicit derivative: excess(t, pi) = 0, so dt = - d_pi excess / d_t excess."""
    fixed, point = dist.detach(), share.clone().requires_grad_()
    with torch.enable_grad():
        (slope,) = torch.autograd.grad(_excess(point, fixed, old, bounds).sum(), point)
    excess = _excess(share, dist, old, bounds)
    # Where the path leaves the region without crossing its border at a slope, t has no derivative.
    return share - torch.where(slope > 1e-6, (excess - excess.detach()) / slope.clamp_min(1e-6), 0.0)
