"""A lower bound on the entropy of a Gaussian policy."""

from __future__ import annotations

import math

import torch

_HALF_LOG_TWO_PI_E = 0.5 * (math.log(2.0 * math.pi) + 1.0)


def raise_entropy(std: torch.Tensor, floor: float, dim: int) -> torch.Tensor:
    """Widen Gaussians whose entropy is below a floor, all axes by the same factor.

        H = d/2 log(2 pi e) + sum_i log std_i,      std <- std exp((floor - H)_+ / d)

    Entropies above the floor stay bitwise. Where the floor is active the result does not change
    with the overall scale of `std`: as with a clamp, another loss must carry that gradient.

    Args:
        std: Standard deviations, (..., d), for sigma^2 I (..., 1), or along and across the mean (..., 2).
        floor: Smallest entropy of one Gaussian [nats]; differential, so it may be negative.
        dim: Action dimension d of one Gaussian.

    Returns:
        Standard deviations in the shape of `std`.
    """
    # The last of fewer deviations than axes is that of all axes that are left.
    copies = [1.0] * (std.shape[-1] - 1) + [1.0 + dim - std.shape[-1]]
    entropy = dim * _HALF_LOG_TWO_PI_E + (std.log() * std.new_tensor(copies)).sum(-1, keepdim=True)
    raised = std * torch.exp((floor - entropy) / dim)
    return torch.where(entropy < floor, raised, std)
