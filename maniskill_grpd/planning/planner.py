"""Plans by sampling, refined and followed for a few steps at a time."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from maniskill_grpd.planning.colored_noise import colored_noise
from maniskill_grpd.planning.cross_entropy import CrossEntropy
from maniskill_grpd.planning.options import PlannerOptions
from maniskill_grpd.planning.path_integral import PathIntegral
from maniskill_grpd.planning.policy_prior import PolicyPrior
from maniskill_grpd.planning.sample_worlds import SampleWorlds, State

METHODS = {"cem": CrossEntropy, "mppi": PathIntegral}


class Planner:
    """Model-predictive control of E episodes, with the simulation itself as the model.

    Every `replan` steps plans are drawn around a mean, tried, and the mean is moved towards the good ones, `iterations` times.
    The mean itself and the best plan so far are among those tried. That best one is followed; what is left of it starts
    the next search. With a prior the mean starts from what the policy would do.

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
        self._plan = self._rest
        self._step = self.options.replan

    def act(self, state: State) -> torch.Tensor:
        """Return the actions (E, D) for the next step of all episodes.

        Args:
            state: What `get_state_dict` of the environment of the episodes returns, rows (E, ...).
        """
        if self._step == self.options.replan:
            rest = self._rest[:, : self.options.replan]
            is_first = self._plan is self._rest
            self._plan = self.search(state, self._plan if is_first else torch.cat([self._plan[:, self._step :], rest], dim=1))
            self._step = 0
        self._step += 1
        return self._plan[:, self._step - 1]

    @torch.no_grad()
    def search(self, state: State, start: torch.Tensor) -> torch.Tensor:
        """Return the best plans found, (E, H, D), beginning with plans (E, H, D)."""
        options, best = self.options, start
        highest = torch.full(start.shape[:1], -torch.inf, device=start.device)
        mean = start if self._prior is None else self._clamp(self._prior.propose(self.worlds, state, options.horizon))
        std = torch.full_like(mean, options.std)
        for iteration in range(options.iterations):
            plans = self._draw(mean, std, best)
            returns = self.worlds.play(state, plans)
            found, winner = returns.max(dim=1)
            is_better = found > highest
            highest = torch.where(is_better, found, highest)
            winners = plans[torch.arange(len(plans), device=plans.device), winner]
            best = torch.where(is_better[:, None, None], winners, best)
            if iteration + 1 < options.iterations:
                mean, std = self._method.refit(mean, std, plans, returns)
        return best

    def _draw(self, mean: torch.Tensor, std: torch.Tensor, best: torch.Tensor) -> torch.Tensor:
        """Return plans (E, S, H, D): the mean, the best one, and others around the mean."""
        count = self.options.samples - 2
        noise = torch.stack([self._noise(count, mean.shape[-1], generator) for generator in self._generators]).to(mean)
        drawn = mean[:, None] + std[:, None] * noise
        return self._clamp(torch.cat([mean[:, None], best[:, None], drawn], dim=1))

    def _noise(self, count: int, width: int, generator: torch.Generator) -> torch.Tensor:
        return colored_noise(count, self.options.horizon, width, self.options.noise_exponent, generator)

    def _clamp(self, plans: torch.Tensor) -> torch.Tensor:
        return torch.minimum(torch.maximum(plans, self._low), self._high)
