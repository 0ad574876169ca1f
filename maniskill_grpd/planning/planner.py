"""Plans by sampling, refined and followed for a few steps at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from maniskill_grpd.planning.colored_noise import colored_noise
from maniskill_grpd.planning.cross_entropy import CrossEntropy
from maniskill_grpd.planning.options import PlannerOptions
from maniskill_grpd.planning.path_integral import PathIntegral
from maniskill_grpd.planning.policy_prior import PolicyPrior
from maniskill_grpd.planning.sample_worlds import SampleWorlds, State

METHODS = {"cem": CrossEntropy, "mppi": PathIntegral}
NUM_KEPT = 3
"""The best plan so far, standing still and the mean are played in every iteration, so as not to lose them."""
FINE_SHARE = 0.25
"""Share of the samples that are finer and finer, to find the goal itself."""
FINEST = 0.1
"""Size of the smallest noise among them, in units of the full one."""


class Planner:
    """Model-predictive control of E episodes, with the simulation itself as the model.

    Every `replan` steps plans are drawn around a mean, tried, and the mean is moved towards the good ones, `iterations` times.
    The mean itself, the best plan so far and standing still are among those tried. The best one is followed; what is left of it
    starts the next search. With a prior the mean starts from what the policy would do.

    Args:
        worlds: Where plans are tried.
        options: Options.
        prior: A policy that proposes plans.
    """

    def __init__(self, worlds: SampleWorlds, options: PlannerOptions, prior: PolicyPrior | None = None) -> None:
        options.check()
        if options.samples != worlds.samples:
            raise ValueError(f"the options say {options.samples} samples, the worlds are for {worlds.samples}")
        self.worlds = worlds
        self.options = options
        self._prior = prior
        self._num_fine = int(FINE_SHARE * options.samples)
        self._method = METHODS[options.method](options)
        self._low, self._high = worlds.bounds
        self._rest = worlds.rest_action.expand(worlds.num_episodes, options.horizon, -1)
        self.begin(range(worlds.num_episodes))

    def begin(self, seeds: Sequence[int]) -> None:
        """Begin new episodes.

        Args:
            seeds: One for each episode; the plans of an episode depend on its own alone.
        """
        if len(seeds) != self.worlds.num_episodes:
            raise ValueError(f"the planner plans for {self.worlds.num_episodes} episodes, got {len(seeds)} seeds")
        self._generators = [torch.Generator().manual_seed(int(seed)) for seed in seeds]
        self._plan, self._is_under_way = self._rest, False
        self._step = self.options.replan

    def act(self, state: State) -> torch.Tensor:
        """Return the actions (E, D) for the next step of all episodes.

        Args:
            state: What `get_state_dict` of the environment of the episodes returns, rows (E, ...).
        """
        if self._step == self.options.replan:
            rest = self._rest[:, : self.options.replan]
            left = torch.cat([self._plan[:, self._step :], rest], dim=1)
            self._plan = self.search(
                state, left, self.options.iterations if self._is_under_way else self.options.first_iterations
            )
            self._step, self._is_under_way = 0, True
        self._step += 1
        return self._plan[:, self._step - 1]

    @torch.no_grad()
    def search(self, state: State, start: torch.Tensor, iterations: int) -> torch.Tensor:
        """Return the best plans found in some iterations, (E, H, D), beginning with plans (E, H, D)."""
        options, best = self.options, start
        highest = torch.full(start.shape[:1], -torch.inf, device=start.device)
        mean = start if self._prior is None else self._clamp(self._prior.propose(self.worlds, state, options.horizon))
        std = torch.full_like(mean, options.std)
        for iteration in range(iterations):
            plans = self._draw(mean, std, best)
            returns = self.worlds.play(state, plans)
            found, winner = returns.max(dim=1)
            is_better = found > highest
            highest = torch.where(is_better, found, highest)
            winners = plans[torch.arange(len(plans), device=plans.device), winner]
            best = torch.where(is_better[:, None, None], winners, best)
            if iteration + 1 < iterations:
                # Fitted to what is kept or fine too, a search stays where every way to the goal leads down first, as in folding.
                fitted = NUM_KEPT + self._num_fine
                mean, std = self._method.refit(mean, std, plans[:, fitted:], returns[:, fitted:])
        return best

    def _draw(self, mean: torch.Tensor, std: torch.Tensor, best: torch.Tensor) -> torch.Tensor:
        """Return plans (E, S, H, D): those that are kept, fine ones, and those that distributions are fitted to."""
        count = self.options.samples - NUM_KEPT
        noise = torch.stack([self._noise(count, mean.shape[-1], generator) for generator in self._generators]).to(mean)
        sizes = torch.ones(count, device=mean.device)
        sizes[: self._num_fine] = torch.logspace(math.log10(FINEST), 0.0, self._num_fine, device=mean.device)
        drawn = mean[:, None] + sizes[:, None, None] * std[:, None] * noise
        return self._clamp(torch.cat([best[:, None], self._rest[:, None], mean[:, None], drawn], dim=1))

    def _noise(self, count: int, width: int, generator: torch.Generator) -> torch.Tensor:
        return colored_noise(count, self.options.horizon, width, self.options.noise_exponent, generator)

    def _clamp(self, plans: torch.Tensor) -> torch.Tensor:
        return torch.minimum(torch.maximum(plans, self._low), self._high)
