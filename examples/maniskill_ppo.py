"""PPO with an MLP on state observations, the way ManiSkill's own baseline trains: its flags, its wrappers, its bootstrapping.

python examples/maniskill_ppo.py --env_id RopeShaping-v1 --num_envs 64 --total_timesteps 1_000_000

It uses nothing of this package but the registered tasks, so that it shows what any learner written for ManiSkill meets here: flat
float32 states, flat actions in [-1, 1], same-step reset with `final_observation`, batched `success` and episode metrics.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass

import gymnasium as gym
import torch
import tyro
from mani_skill.vector.wrappers.gymnasium import ManiSkillVectorEnv
from torch import nn
from tqdm import trange

import maniskill_grpd  # noqa: F401  (registers the tasks)


@dataclass(frozen=True, kw_only=True)
class PpoConfig:
    """Options, under the names and with the defaults of ManiSkill's baseline where these suit 100 steps per episode."""

    env_id: str = "RopeShaping-v1"
    """id of the task"""
    num_envs: int = 64
    """number of worlds"""
    num_eval_envs: int = 16
    """number of worlds, and of episodes, of the evaluation at the end"""
    partial_reset: bool = True
    """end an episode when its world terminates"""
    num_steps: int = 50
    """steps of each world per iteration"""
    total_timesteps: int = 1_000_000
    """environment steps of the whole training"""
    learning_rate: float = 3e-4
    """step size of Adam"""
    gamma: float = 0.99
    """discount"""
    gae_lambda: float = 0.95
    """lambda of generalised advantage estimation"""
    num_minibatches: int = 16
    """minibatches per epoch"""
    update_epochs: int = 4
    """passes over each rollout"""
    clip_coef: float = 0.2
    """clipping of the probability ratio"""
    vf_coef: float = 0.5
    """weight of the value loss"""
    max_grad_norm: float = 0.5
    """largest norm of the gradient"""
    target_kl: float = 0.1
    """an update stops when the KL of a minibatch exceeds this [nats]"""
    seed: int = 1
    """seed of the network, the actions and the worlds"""
    sim_backend: str = "auto"
    """auto (cuda if there is a GPU), cpu or cuda"""


class MlpAgent(nn.Module):
    """A Gaussian policy with one standard deviation per action, and a value function, both MLPs of three layers."""

    def __init__(self, state_dim: int, action_dim: int) -> None:
        super().__init__()
        self.critic = _mlp(state_dim, 1, gain=1.0)
        self.actor = _mlp(state_dim, action_dim, gain=0.01 * 2**0.5)
        self.log_std = nn.Parameter(torch.full((action_dim,), -0.5))

    def distribution(self, states: torch.Tensor) -> torch.distributions.Independent:
        """Distribution of the actions (B, D) in states (B, S)."""
        return torch.distributions.Independent(torch.distributions.Normal(self.actor(states), self.log_std.exp()), 1)

    def value(self, states: torch.Tensor) -> torch.Tensor:
        """Value (B,) of states (B, S)."""
        return self.critic(states)[:, 0]


def train(config: PpoConfig) -> dict[str, float]:
    """Train as configured, then evaluate; returns the metrics of the evaluation."""
    torch.set_num_threads(1)
    torch.manual_seed(config.seed)
    envs = make_envs(config, config.num_envs, ignore_terminations=not config.partial_reset)
    agent = MlpAgent(envs.single_observation_space.shape[0], envs.single_action_space.shape[0]).to(envs.device)
    optimizer = torch.optim.Adam(agent.parameters(), lr=config.learning_rate, eps=1e-5)
    state, _ = envs.reset(seed=config.seed)
    for _ in trange(config.total_timesteps // (config.num_envs * config.num_steps), desc="PPO", unit="iteration"):
        rollout, state = collect(agent, envs, state, config)
        update(agent, optimizer, rollout, config)
    envs.close()
    metrics = evaluate(agent, config)
    print({name: round(value, 3) for name, value in metrics.items()})
    return metrics


def make_envs(config: PpoConfig, num_envs: int, *, ignore_terminations: bool) -> ManiSkillVectorEnv:
    """Make a vector environment with flat states."""
    env = gym.make(config.env_id, num_envs=num_envs, obs_mode="state", sim_backend=config.sim_backend)
    return ManiSkillVectorEnv(env, num_envs, ignore_terminations=ignore_terminations, record_metrics=True)


@torch.no_grad()
def collect(
    agent: MlpAgent, envs: ManiSkillVectorEnv, state: torch.Tensor, config: PpoConfig
) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Act for `num_steps` and estimate advantages.

    Where an episode ends, by success or by the time limit, the value of its last state stands for the rest, as in ManiSkill's
    baseline: V(s') there is that of `final_observation`, not of the state after the reset.

    Returns:
        Flat tensors (T * B, ...): states, actions, log_probs, advantages, returns; and the state that follows.
    """
    names = ("states", "actions", "log_probs", "values", "rewards", "dones", "next")
    rows: dict[str, list[torch.Tensor]] = {name: [] for name in names}
    for _ in range(config.num_steps):
        policy = agent.distribution(state)
        action = policy.sample()
        rows["states"].append(state)
        rows["actions"].append(action)
        rows["log_probs"].append(policy.log_prob(action))
        rows["values"].append(agent.value(state))
        state, reward, terminated, truncated, info = envs.step(action)
        done = terminated | truncated
        following = info.get("final_observation", state)
        rows["next"].append(agent.value(torch.where(done[:, None], following, state)))
        rows["rewards"].append(reward)
        rows["dones"].append(done.float())
    stacked = {name: torch.stack(entries) for name, entries in rows.items()}
    advantages = torch.zeros_like(stacked["rewards"])
    running = torch.zeros_like(advantages[0])
    for step in reversed(range(config.num_steps)):
        delta = stacked["rewards"][step] + config.gamma * stacked["next"][step] - stacked["values"][step]
        running = delta + config.gamma * config.gae_lambda * (1.0 - stacked["dones"][step]) * running
        advantages[step] = running
    rollout = {name: stacked[name].flatten(0, 1) for name in ("states", "actions", "log_probs")}
    return rollout | {"advantages": advantages.flatten(), "returns": (advantages + stacked["values"]).flatten()}, state


def update(agent: MlpAgent, optimizer: torch.optim.Optimizer, rollout: dict[str, torch.Tensor], config: PpoConfig) -> None:
    """Take the gradient steps of one iteration (Schulman et al. 2017, arXiv:1707.06347)."""
    total = len(rollout["returns"])
    for _ in range(config.update_epochs):
        for index in torch.randperm(total, device=rollout["returns"].device).chunk(config.num_minibatches):
            batch = {name: values[index] for name, values in rollout.items()}
            log_ratio = agent.distribution(batch["states"]).log_prob(batch["actions"]) - batch["log_probs"]
            ratio = log_ratio.exp()
            if (ratio - 1.0 - log_ratio).mean().item() > config.target_kl:
                return
            advantages = (batch["advantages"] - batch["advantages"].mean()) / (batch["advantages"].std() + 1e-8)
            clipped = ratio.clamp(1.0 - config.clip_coef, 1.0 + config.clip_coef)
            policy_loss = -torch.minimum(advantages * ratio, advantages * clipped).mean()
            value_loss = 0.5 * (agent.value(batch["states"]) - batch["returns"]).square().mean()
            optimizer.zero_grad()
            (policy_loss + config.vf_coef * value_loss).backward()
            nn.utils.clip_grad_norm_(agent.parameters(), config.max_grad_norm)
            optimizer.step()


@torch.no_grad()
def evaluate(agent: MlpAgent, config: PpoConfig) -> dict[str, float]:
    """Return ManiSkill's episode metrics of one episode per evaluation world, with the mean action."""
    envs = make_envs(config, config.num_eval_envs, ignore_terminations=True)
    state, _ = envs.reset(seed=1_000_000)
    info: dict = {}
    while "final_info" not in info:
        state, _, _, _, info = envs.step(agent.actor(state))
    envs.close()
    return {name: float(values.float().mean()) for name, values in info["final_info"]["episode"].items()}


def _mlp(inputs: int, outputs: int, *, gain: float) -> nn.Sequential:
    widths = [inputs, 256, 256, 256]
    layers: list[nn.Module] = []
    for width, following in zip(widths[:-1], widths[1:], strict=True):
        layers += [_orthogonal(nn.Linear(width, following), 2**0.5), nn.Tanh()]
    return nn.Sequential(*layers, _orthogonal(nn.Linear(widths[-1], outputs), gain))


def _orthogonal(layer: nn.Linear, gain: float) -> nn.Linear:
    nn.init.orthogonal_(layer.weight, gain)
    nn.init.zeros_(layer.bias)
    return layer


def main(arguments: Sequence[str]) -> None:
    """Parse the command line and train."""
    train(tyro.cli(PpoConfig, args=list(arguments), description=__doc__))


if __name__ == "__main__":
    main(sys.argv[1:])
