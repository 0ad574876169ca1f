"""A learner in the style of ManiSkill's stock PPO: networks of dense layers on flat state observations.

Written for comparison of speed, with the sizes and the update of ManiSkill's examples/baselines/ppo/ppo.py: three layers of 256
units with tanh for actor and critic each, one learned deviation per action, 4 epochs of 32 minibatches, Adam, gradients clipped
to 0.5. The rollout has the same number of environments and steps as that of the learner beside it.
"""

from __future__ import annotations

import time
from typing import Any

import torch
from torch import nn
from torch.distributions import Normal

from maniskill_grpd.learning.gae import generalized_advantages

EPOCHS, MINIBATCHES, CLIP, MAX_GRAD_NORM, LEARNING_RATE = 4, 32, 0.2, 0.5, 3e-4


def dense(sizes: list[int]) -> nn.Sequential:
    """Return linear layers with tanh between them."""
    layers: list[nn.Module] = []
    for width, following in zip(sizes, sizes[1:], strict=False):
        layers += [nn.Linear(width, following), nn.Tanh()]
    return nn.Sequential(*layers[:-1])


class StockPPO:
    """Steps a vector environment and learns from it.

    Args:
        envs: ManiSkillVectorEnv with state observations (B, S).
        num_steps: Steps of a rollout.

    Attributes:
        times: Seconds of the last iteration: rollout, env (its share of the rollout), update.
    """

    def __init__(self, envs: Any, num_steps: int) -> None:
        self.envs, self.num_steps = envs, num_steps
        self.obs, _ = envs.reset(seed=0)
        state_dim, action_dim = self.obs.shape[1], envs.single_action_space.shape[0]
        self.actor = dense([state_dim, 256, 256, 256, action_dim])
        self.critic = dense([state_dim, 256, 256, 256, 1])
        self.log_std = nn.Parameter(torch.full((action_dim,), -0.5))
        self.parameters = [*self.actor.parameters(), *self.critic.parameters(), self.log_std]
        self.optimizer = torch.optim.Adam(self.parameters, lr=LEARNING_RATE, eps=1e-5)
        self.times: dict[str, float] = {}

    def run_iteration(self) -> None:
        """Collect and learn once."""
        start = time.perf_counter()
        rollout = self._collect()
        self.times["rollout"] = time.perf_counter() - start
        self._update(*rollout)
        self.times["update"] = time.perf_counter() - start - self.times["rollout"]

    @torch.no_grad()
    def _collect(self) -> tuple[torch.Tensor, ...]:
        rows, self.times["env"] = [], 0.0
        for _ in range(self.num_steps):
            normal = self._policy(self.obs)
            action = normal.sample()
            value = self.critic(self.obs).squeeze(-1)
            start = time.perf_counter()
            following, reward, terminated, truncated, info = self.envs.step(action)
            self.times["env"] += time.perf_counter() - start
            final = torch.zeros_like(value)
            if truncated.any():
                final = self.critic(info["final_observation"]).squeeze(-1)
            log_prob = normal.log_prob(action).sum(-1)
            rows.append((self.obs, action, log_prob, value, reward, terminated, truncated, final))
            self.obs = following
        obs, actions, log_probs, values, rewards, terminated, truncated, final = map(torch.stack, zip(*rows, strict=True))
        next_value = self.critic(self.obs).squeeze(-1)
        advantages, returns = generalized_advantages(
            rewards, values, next_value, terminated, truncated, final, gamma=0.8, gae_lambda=0.9
        )
        return tuple(tensor.flatten(0, 1) for tensor in (obs, actions, log_probs, advantages, returns))

    def _update(self, obs, actions, log_probs, advantages, returns) -> None:
        for _ in range(EPOCHS):
            for index in torch.randperm(len(obs)).split(len(obs) // MINIBATCHES):
                normal = self._policy(obs[index])
                ratio = (normal.log_prob(actions[index]).sum(-1) - log_probs[index]).exp()
                advantage = (advantages[index] - advantages[index].mean()) / (advantages[index].std() + 1e-8)
                loss = torch.max(-advantage * ratio, -advantage * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
                loss = loss + 0.25 * (self.critic(obs[index]).squeeze(-1) - returns[index]).square().mean()
                self.optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.parameters, MAX_GRAD_NORM)
                self.optimizer.step()

    def _policy(self, obs: torch.Tensor) -> Normal:
        return Normal(self.actor(obs), self.log_std.exp())
