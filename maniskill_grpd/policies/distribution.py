"""Distribution over the actions of all actuators."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import torch
from torch.nn.functional import logsigmoid, softplus

from maniskill_grpd.policies.directed_gaussian import Spread, spread
from maniskill_grpd.policies.divergence import KLParts, bernoulli_kl, gaussian_kl_parts

_LOG_TWO_PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, eq=False)
class ActionDistribution:
    """Independent Gaussians, one per actuator: isotropic, N(mean, std^2 I) (eq. 53, 54), or `directed_gaussian`s.

    With grippers each actuator has a Bernoulli variable g beside it (eq. 56): 1 closes, 0 opens.
    An action then holds (x, y, z, g) per actuator, and every density, entropy and divergence is
    that of the joint distribution. Shapes below have E = 3 entries per actuator, or 4 with gripper.

    Masked actuators have mean zero, sample zero and no share in any sum.

    Attributes:
        mean: (B, A, 3), in units of the largest displacement per step.
        std: (B, A, 1), positive; of directed Gaussians (B, A, 2), along the mean and across it.
        mask: (B, A) bool.
        gripper_logits: Log-odds of g = 1, (B, A); None without grippers.
    """

    mean: torch.Tensor
    std: torch.Tensor
    mask: torch.Tensor
    gripper_logits: torch.Tensor | None = None

    @property
    def spread(self) -> Spread | None:
        """Principal axes of directed Gaussians; None of isotropic ones."""
        return spread(self.mean, self.std) if self.std.shape[-1] == 2 else None

    @property
    def mode(self) -> torch.Tensor:
        """Most likely action, (B, A * E)."""
        action = self.mean
        if self.gripper_logits is not None:
            closed = (self.gripper_logits > 0).to(action.dtype)
            action = torch.cat([action, closed[..., None]], dim=-1)
        return action.masked_fill(~self.mask[..., None], 0.0).flatten(1)

    def sample(self, generator: torch.Generator | None = None, noise: torch.Tensor | None = None) -> torch.Tensor:
        """Draw one action per graph, (B, A * E), without gradient.

        Args:
            generator: Source of what is drawn.
            noise: Standard normal noise (B, A, 3) of the Gaussians; by default it is drawn.
        """
        with torch.no_grad():
            if noise is None:
                noise = torch.randn(self.mean.shape, generator=generator, device=self.mean.device, dtype=self.mean.dtype)
            axes = self.spread
            action = self.mean + (self.std * noise if axes is None else axes.apply(noise))
            if self.gripper_logits is not None:
                probability = torch.sigmoid(self.gripper_logits)
                closed = torch.bernoulli(probability, generator=generator)
                action = torch.cat([action, closed[..., None]], dim=-1)
            return action.masked_fill(~self.mask[..., None], 0.0).flatten(1)

    def log_prob(self, action: torch.Tensor) -> torch.Tensor:
        """Log density [nats] summed over actuators.

        Args:
            action: (B, A * E) or (B, A, E).

        Returns:
            (B,).
        """
        dims = self.mean.shape[-1]
        action = action.reshape(*self.mean.shape[:-1], dims + (self.gripper_logits is not None))
        offset, axes = action[..., :dims] - self.mean, self.spread
        squared = (offset / self.std).square().sum(-1) if axes is None else axes.squared_distance(offset)
        log_prob = -0.5 * (squared + dims * _LOG_TWO_PI) - self._log_volume(axes)
        if self.gripper_logits is not None:
            closed, logits = action[..., dims], self.gripper_logits
            log_prob = log_prob + closed * logsigmoid(logits) + (1 - closed) * logsigmoid(-logits)
        return self._sum(log_prob)

    def entropy(self) -> torch.Tensor:
        """Entropy [nats] summed over actuators, (B,): differential, of grippers discrete."""
        dims = self.mean.shape[-1]
        entropy = 0.5 * dims * (1.0 + _LOG_TWO_PI) + self._log_volume(self.spread)
        if self.gripper_logits is not None:
            logits = self.gripper_logits
            # H = p softplus(-l) + (1 - p) softplus(l), whose terms never are 0 * inf.
            probability = torch.sigmoid(logits)
            entropy = entropy + softplus(logits) - probability * logits
        return self._sum(entropy)

    def spherical_entropies(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Entropy of length and of direction of each actuator's action (eq. 54) [nats], each (B, A).

        To first order in std / |mean| the length of an action has deviation std (of directed Gaussians that along the mean), its
        direction std / |mean| rad on two axes (that across it):

            radial   1/2 log(2 pi e std^2),    angular   log(2 pi e (std / |mean|)^2)

        The angular one ends at log 4 pi, that of directions spread evenly over the sphere. Where masked both are zero.
        """
        axes = self.spread
        along, across = (self.std, self.std) if axes is None else (axes.along, axes.across)
        log_length = self.mean.norm(dim=-1).clamp(min=1e-6).log()
        radial = 0.5 * (1.0 + _LOG_TWO_PI) + along.squeeze(-1).log()
        angular = (1.0 + _LOG_TWO_PI + 2.0 * (across.squeeze(-1).log() - log_length)).clamp(max=math.log(4.0 * math.pi))
        return radial.masked_fill(~self.mask, 0.0), angular.masked_fill(~self.mask, 0.0)

    def kl_parts(self, old: ActionDistribution) -> KLParts:
        """KL(self || old) of each actuator in its parts: Gaussian mean and covariance (eq. 63), gripper (eq. 56).

        Args:
            old: The reference, of the same shapes.

        Returns:
            The parts [nats], each (B, A) and zero where masked; `.total` is that of whole actions, (B,).
        """
        axes, old_axes = self.spread, old.spread
        if axes is None:
            mean, cov = gaussian_kl_parts(self.mean, self.std, old.mean, old.std)
        else:
            mean, cov = 0.5 * old_axes.squared_distance(self.mean - old.mean), axes.kl_cov(old_axes)
        gripper = torch.zeros_like(mean)
        if self.gripper_logits is not None:
            gripper = bernoulli_kl(self.gripper_logits, old.gripper_logits)
        return KLParts(*(part.masked_fill(~self.mask, 0.0) for part in (mean, cov, gripper)))

    def items(self) -> Iterator[tuple[str, torch.Tensor]]:
        """Yield the tensors by name; gripper_logits only where there are grippers."""
        for entry in fields(self):
            if getattr(self, entry.name) is not None:
                yield entry.name, getattr(self, entry.name)

    def map(self, function: Callable[[torch.Tensor], torch.Tensor]) -> ActionDistribution:
        """Return the distribution of the tensors that a function makes of these, the mask included."""
        return ActionDistribution(**{name: function(tensor) for name, tensor in self.items()})

    def detach(self) -> ActionDistribution:
        """Return the same distribution, through which no gradient flows."""
        return self.map(torch.Tensor.detach)

    def _log_volume(self, axes: Spread | None) -> torch.Tensor:
        """Return the logarithm of the product of the standard deviations of all axes, (B, A)."""
        return self.mean.shape[-1] * self.std.squeeze(-1).log() if axes is None else axes.log_volume()

    def _sum(self, per_actuator: torch.Tensor) -> torch.Tensor:
        return per_actuator.masked_fill(~self.mask, 0.0).sum(-1)
