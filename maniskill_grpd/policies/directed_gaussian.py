"""Gaussians that spread along their mean otherwise than across it: noise in length and direction of an action apart.

    action = mean + L z,    z ~ N(0, I),    L = across I + (along - across) m m^T / (|m|^2 + r^2),   r = 0.05

L turns with the mean m, so the distribution is as equivariant as the isotropic one (eq. 54). The radius r makes it smooth where a
mean passes through zero and has no direction; a mean of the largest action, length 1, has 99.75 % of `along`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch

from maniskill_grpd.policies.divergence import kl_cov

_RADIUS = 0.05


class Spread(NamedTuple):
    """Principal axes of the covariance of each actuator.

    Attributes:
        direction: Direction of the mean, (B, A, 3); zero where the mean is.
        along: Standard deviation in that direction, (B, A, 1).
        across: Standard deviation in the two others, (B, A, 1).
    """

    direction: torch.Tensor
    along: torch.Tensor
    across: torch.Tensor

    def apply(self, noise: torch.Tensor) -> torch.Tensor:
        """Return L z of standard normal noise z, (B, A, 3)."""
        return self.across * noise + (self.along - self.across) * self._length(noise) * self.direction

    def squared_distance(self, offset: torch.Tensor) -> torch.Tensor:
        """Return offset^T Sigma^-1 offset, (B, A), of offsets (B, A, 3) from the mean."""
        length = self._length(offset)
        across = (offset - length * self.direction) / self.across
        return across.square().sum(-1) + (length / self.along).square().squeeze(-1)

    def log_volume(self) -> torch.Tensor:
        """Return log det L, (B, A)."""
        return (self.along.log() + 2.0 * self.across.log()).squeeze(-1)

    def kl_cov(self, old: Spread) -> torch.Tensor:
        """Return the covariance part of KL(new || old), (B, A) [nats].

        With variances A along and C across and the angle w between the directions,

            1/2 [ x(A / A_old) + 2 x(C / C_old) + (A - C) (A_old - C_old) / (A_old C_old) sin^2 w ],   x(q) = q - 1 - log q
        """
        axes, old_axes = (torch.cat([spread.along, spread.across, spread.across], dim=-1) for spread in (self, old))
        sine = torch.linalg.cross(self.direction, old.direction).square().sum(-1).double()
        along, across, old_along, old_across = (
            width.squeeze(-1).double().square() for width in (self.along, self.across, old.along, old.across)
        )
        turned = 0.5 * (along - across) * (old_along - old_across) / (old_along * old_across) * sine
        return kl_cov(axes, old_axes, 3) + turned.to(self.along.dtype)

    def _length(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return components (B, A, 1) in the direction of the mean."""
        return (vectors * self.direction).sum(-1, keepdim=True)


def spread(mean: torch.Tensor, std: torch.Tensor) -> Spread:
    """Return the principal axes of Gaussians.

    Args:
        mean: (B, A, 3).
        std: Deviations along the mean (far from zero) and across it, (B, A, 2).
    """
    along, across = std.split(1, dim=-1)
    squared = mean.square().sum(-1, keepdim=True)
    share = squared / (squared + _RADIUS**2)
    # The floor is far below the radius: it keeps the gradient finite where `along` no longer differs from `across`.
    direction = mean * squared.clamp_min(1e-12).rsqrt()
    return Spread(direction, across + share * (along - across), across)
