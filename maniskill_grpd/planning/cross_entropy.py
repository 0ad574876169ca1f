"""The cross-entropy method."""

from __future__ import annotations

import torch

from maniskill_grpd.planning.options import PlannerOptions

SMALLEST_STD = 0.02
"""Distributions do not become narrower than this, in units of the largest action."""
MEMORY = 0.1
"""Share of its last mean and deviation that a distribution keeps."""


class CrossEntropy:
    """Fits the distribution of plans to the best ones (Rubinstein 1999)."""

    def __init__(self, options: PlannerOptions) -> None:
        self._num_elites = options.num_elites

    def refit(
        self, mean: torch.Tensor, std: torch.Tensor, plans: torch.Tensor, returns: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and standard deviation of the next plans, (E, H, D) each.

        Args:
            mean: Of the plans that were drawn, (E, H, D).
            std: Of them, (E, H, D).
            plans: (E, S, H, D).
            returns: What they brought, (E, S).
        """
        best = returns.argsort(dim=1, descending=True, stable=True)[:, : self._num_elites]
        elites = plans.gather(1, best[:, :, None, None].expand(-1, -1, *plans.shape[2:]))
        spread = elites.std(dim=1).clamp(min=SMALLEST_STD)
        return torch.lerp(elites.mean(dim=1), mean, MEMORY), torch.lerp(spread, std, MEMORY)
