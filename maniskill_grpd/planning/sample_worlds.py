"""The worlds in which plans are tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import gymnasium as gym
import torch

from maniskill_grpd.learning.rollout import map_graph
from maniskill_grpd.planning.restorable import check_restorable

State = Mapping[str, Any]
"""What `get_state_dict` returns: nested, leaves (E, D), a row for each episode."""
Value = Callable[[Any], torch.Tensor]
"""From an observation of B worlds to the return that is expected from there on, (B,)."""


class SampleWorlds:
    """Tries S plans for each of E episodes at once, in an environment of E * S worlds that has no other use.

    Args:
        env: A batched ManiSkill environment whose state can be restored, of the task and with the options of the episodes.
        samples: Number S of plans for each episode.
        discount: Of rewards.
        final_weight: Steps that the last reward counts for.
        value: Stands for the future after the last step, in place of `final_weight`.

    Attributes:
        num_episodes: Number E of episodes.
        bounds: Smallest and largest actions, (D,) each.
        rest_action: What keeps all as it is, (D,): no motion, grippers closed.
        num_steps: Environment steps taken so far, over all worlds.

    Raises:
        ValueError: If the state cannot be restored, actions are not displacements of one agent, or the worlds cannot be shared.
    """

    def __init__(
        self, env: gym.Env, samples: int, *, discount: float = 1.0, final_weight: float = 0.0, value: Value | None = None
    ) -> None:
        base = env.unwrapped
        if base.num_envs % samples:
            raise ValueError(f"{base.num_envs} worlds cannot be shared by plans of {samples} samples: give a multiple")
        self.rest_action = rest_action(env)
        space = base.single_action_space
        self.bounds = tuple(torch.as_tensor(bound, device=base.device) for bound in (space.low, space.high))
        env.reset(seed=0)
        check_restorable(env, 0.5 * self.bounds[1].expand(base.num_envs, -1))
        self._env, self._base = env, base
        self.samples, self.num_episodes = samples, base.num_envs // samples
        self._discount, self._final_weight, self._value = discount, final_weight, value
        self.num_steps = 0

    def enter(self, state: State) -> None:
        """Put all worlds of an episode into its state."""
        self._base.set_state_dict(map_graph(lambda leaf: leaf.repeat_interleave(self.samples, dim=0), state))

    def observe(self) -> Any:
        """Return what the first world of each episode shows, rows (E, ...)."""
        return map_graph(lambda leaf: leaf[:: self.samples], self._base.get_obs())

    def step(self, actions: torch.Tensor) -> tuple[Any, torch.Tensor]:
        """Take actions (E, S, D); return the observation of all worlds and the rewards (E, S)."""
        obs, reward, *_ = self._env.step(actions.flatten(0, 1))
        self.num_steps += self._base.num_envs
        return obs, reward.view(-1, self.samples)

    def play(self, state: State, plans: torch.Tensor) -> torch.Tensor:
        """Play plans (E, S, H, D) from the states of the episodes.

        Returns:
            sum_t discount^t r_t + discount^(H - 1) final_weight r_(H - 1), or + discount^H V(s_H); (E, S).
        """
        self.enter(state)
        returns, weight = 0.0, 1.0
        for actions in plans.unbind(dim=2):
            obs, reward = self.step(actions)
            returns, last = returns + weight * reward, weight * reward
            weight *= self._discount
        if self._value is None:
            return returns + self._final_weight * last
        return returns + weight * self._value(obs).view(-1, self.samples)

    def close(self) -> None:
        """Close the environment."""
        self._env.close()


def rest_action(env: gym.Env) -> torch.Tensor:
    """Return the action of an environment that keeps all as it is, (D,).

    Raises:
        ValueError: If its actions are no displacements, or of several agents.
    """
    base = env.unwrapped
    space = base.single_action_space
    if not isinstance(space, gym.spaces.Box):
        raise ValueError(
            f"plans are made for one agent, got actions of {', '.join(space)}: choose the robot that has all grippers, "
            "floating_grippers_N"
        )
    if "delta" not in base.control_mode:
        raise ValueError(
            f"plans are displacements, which control mode {base.control_mode} does not take; choose pd_ee_delta_pos for example"
        )
    action = torch.zeros(space.shape, device=base.device)
    if base.control_mode.endswith("_grip"):
        action.view(-1, 4)[:, 3] = 1.0
    return action
