"""Projection of a gripper's Bernoulli variable onto a KL trust region.

The nearest Bernoulli variable, in KL(projected || new), with KL(projected || old) <= bound mixes the
log-odds of the new and the old one. In one dimension that is a clamp: the old log-odds plus the
share t of the change, t in (0, 1], at which

    KL(t) = p (l_t - l_0) - softplus(l_t) + softplus(l_0) = bound,      l_t = l_0 + t (l_1 - l_0)

with p = sigmoid(l_t). KL'(t) = t (l_1 - l_0)^2 p (1 - p) >= 0, so the root is unique.
"""

from __future__ import annotations

import torch

from maniskill_grpd.policies.divergence import bernoulli_kl

_MAX_ROOT_STEPS = 80
"""More than bisection alone needs in float64; Newton steps end it after about eight."""
_SHRINK = 1e-6
"""The bound is undershot by this share, more than rounding to float32 can move the KL there."""
_ROOT_TOLERANCE = 1e-9
"""Accuracy of the KL at the root, relative to the bound."""
_LARGEST_LOGIT = 40.0
"""sigmoid(40) differs from 1 by less than float64 resolves; beyond it, the KL has no slope left."""


def project_bernoulli(logits: torch.Tensor, old_logits: torch.Tensor, *, bound: float | torch.Tensor) -> torch.Tensor:
    """Clamp log-odds so that the KL to the old variable stays within a bound.

    Variables inside the bound come back bitwise unchanged; one that is clamped has no gradient, the
    trust-region loss of BPP carries the signal there.

    Args:
        logits: New log-odds, any shape.
        old_logits: Log-odds of the behaviour policy, same shape.
        bound: Largest KL(projected || old), > 0 [nats]; one for all, or broadcastable to `logits`.

    Returns:
        Projected log-odds in the shape of `logits`.

    Raises:
        ValueError: If the bound is not positive and finite, or shapes differ.
    """
    if not (torch.isfinite(limits := torch.as_tensor(bound)) & (limits > 0.0)).all():
        raise ValueError(f"bound must be positive and finite, got {bound}")
    if logits.shape != old_logits.shape:
        raise ValueError(f"logits and old_logits must share a shape, got {tuple(logits.shape)} and {tuple(old_logits.shape)}")
    with torch.no_grad():
        new, old = logits.double(), old_logits.double()
        active = bernoulli_kl(new, old) > bound
        if not active.any():
            return logits
        # All bits beyond this are saturation; without the cut KL(t) would be flat near t = 1.
        change = torch.where(active, new.clamp(-_LARGEST_LOGIT, _LARGEST_LOGIT) - old, 1.0)
        share = _share_within(old, change, (1.0 - _SHRINK) * bound)
        clamped = (old + share * change).to(logits.dtype)
        clamped = _round_inside(clamped, old_logits, bound)
    return torch.where(active, clamped, logits)


def _share_within(old: torch.Tensor, change: torch.Tensor, bound: float | torch.Tensor) -> torch.Tensor:
    """Find the share of the change at which the KL is `bound`: Newton, bisecting where it leaves."""
    low, high = torch.zeros_like(change), torch.ones_like(change)
    share = 0.5 * high
    for _ in range(_MAX_ROOT_STEPS):
        residual = bernoulli_kl(old + share * change, old) - bound
        low = torch.where(residual <= 0, share, low)
        high = torch.where(residual > 0, share, high)
        if ((residual.abs() <= _ROOT_TOLERANCE * bound) | (high - low < 1e-15)).all():
            break
        probability = torch.sigmoid(old + share * change)
        slope = share * change.square() * probability * (1.0 - probability)
        newton = share - residual / slope
        share = torch.where((newton > low) & (newton < high), newton, 0.5 * (low + high))
    return share


def _round_inside(clamped: torch.Tensor, old: torch.Tensor, bound: float | torch.Tensor) -> torch.Tensor:
    """Move values that rounding left outside the region one float towards the old ones."""
    outside = bernoulli_kl(clamped.double(), old.double()) > bound
    return torch.where(outside, torch.nextafter(clamped, old), clamped)
