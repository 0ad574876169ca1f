"""Model-predictive path integral control."""

from __future__ import annotations

import torch

from maniskill_grpd.planning.options import PlannerOptions

SMALLEST_SPREAD = 1e-6
"""Of returns: where all plans bring the same, they weigh the same."""


class PathIntegral:
    """Moves the mean of the plans to the average of all, weighted by exp(return / temperature) (Williams et al. 2017, MPPI).

    Returns are taken in their standard deviations, so that one temperature fits all tasks and all phases of an episode.
    """

    def __init__(self, options: PlannerOptions) -> None:
        self._temperature = options.temperature

    def refit(
        self, mean: torch.Tensor, std: torch.Tensor, plans: torch.Tensor, returns: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return mean and standard deviation of the next plans, (E, H, D) each; arguments as of `CrossEntropy.refit`."""
        scale = self._temperature * returns.std(dim=1, keepdim=True).clamp(min=SMALLEST_SPREAD)
        weights = torch.softmax(returns / scale, dim=1)
        return (weights[:, :, None, None] * plans).sum(dim=1), std
