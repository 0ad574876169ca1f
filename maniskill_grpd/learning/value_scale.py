"""Running scale of returns, so that the value network regresses numbers of order one."""

from __future__ import annotations

import math

import torch

from maniskill_grpd.learning.protocols import ActorCritic
from maniskill_grpd.learning.workers import Workers


class ValueScale:
    """Maps the output of the value network to returns: V = mean + std * output.

    With rewards in [0, 1] per step and gamma 0.99 returns reach 60; without a scale the value loss
    would drown the policy loss in shared layers and in the gradient norm. Mean and mean square are
    averages over recent rollouts, bias-corrected as in Adam: early returns say little about late
    ones. When they move, `update` lets every value move along, which follows returns that rise together;
    `adapt` corrects the last layer of the network so that values stay what they were (van Hasselt et al.
    2016, PopArt).

    Args:
        decay: Weight of the past when a rollout is added, in [0, 1).
    """

    def __init__(self, decay: float = 0.9) -> None:
        self.decay = decay
        self._weight = 0.0
        self._mean = 0.0
        self._mean_square = 0.0

    @property
    def mean(self) -> float:
        """Mean of recent returns; zero before the first update."""
        return self._mean / self._weight if self._weight else 0.0

    @property
    def std(self) -> float:
        """Standard deviation of recent returns, one before the first update."""
        if not self._weight:
            return 1.0
        variance = self._mean_square / self._weight - self.mean**2
        # Constant returns have no scale; below 1e-2 the regression would amplify noise.
        return max(variance, 1e-4) ** 0.5

    def update(self, returns: torch.Tensor, workers: Workers | None = None) -> None:
        """Add the returns of one rollout, of all processes if there are several."""
        workers = workers or Workers()
        returns = returns.double()
        moments = torch.stack([returns.mean(), returns.square().mean()])
        mean, square = (workers.sum(moments) / workers.size).tolist()
        self._weight = self.decay * self._weight + 1.0 - self.decay
        self._mean = self.decay * self._mean + (1.0 - self.decay) * mean
        self._mean_square = self.decay * self._mean_square + (1.0 - self.decay) * square

    def adapt(self, policy: ActorCritic, returns: torch.Tensor, workers: Workers | None = None) -> None:
        """Add the returns of one rollout and leave the values of a policy as they are.

        The first returns are taken without a correction: what an untrained network gives then means the average return
        instead of zero.

        Args:
            policy: Its value function is corrected in place.
            returns: Of one rollout.
            workers: The processes.
        """
        is_first, mean, std = not self._weight, self.mean, self.std
        self.update(returns, workers)
        if not is_first:
            policy.rescale_value(std / self.std, (mean - self.mean) / self.std)

    def normalize(self, returns: torch.Tensor) -> torch.Tensor:
        """Return the regression targets of the value network."""
        return (returns - self.mean) / self.std

    def denormalize(self, outputs: torch.Tensor) -> torch.Tensor:
        """Return values in the units of the returns."""
        return self.mean + self.std * outputs

    def state_dict(self) -> dict[str, float]:
        """Return the statistics as plain numbers."""
        return {"weight": self._weight, "mean": self._mean, "mean_square": self._mean_square}

    def load_state_dict(self, state: dict[str, float]) -> None:
        """Restore what `state_dict` returned.

        Raises:
            ValueError: If a number is not finite.
        """
        numbers = [float(state[name]) for name in ("weight", "mean", "mean_square")]
        if not all(map(math.isfinite, numbers)):
            raise ValueError(f"the scale of the returns must be finite, got {state}")
        self._weight, self._mean, self._mean_square = numbers
