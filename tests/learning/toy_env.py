"""A vector environment with a graph observation and a tiny policy, both without a simulator.

Each of A actuators is a point that must reach its goal. The best policy moves straight there.
"""

from __future__ import annotations

from types import SimpleNamespace

import torch
from torch import nn

from maniskill_grpd.graphs import Channel, GraphNormalizer, GraphSchema, NodeSchema
from maniskill_grpd.policies import ActionDistribution

STEP_SIZE = 0.1

GOAL_OFFSET = Channel("goal_offset", "vector", "m", "toy", starts_at="node")
GOAL_DISTANCE = Channel("goal_distance", "scalar", "m", "toy", distance_of="goal_offset")
SCHEMA = GraphSchema(
    object=NodeSchema(vectors=(GOAL_OFFSET,), scalars=(GOAL_DISTANCE,)),
    actuator=NodeSchema(vectors=(GOAL_OFFSET,), scalars=(GOAL_DISTANCE,)),
    length_scale=1.0,
    edge_length=1.0,
)


class ToyEnv:
    """Steps like a ManiSkillVectorEnv that resets itself and records metrics.

    Args:
        num_envs: Number of environments.
        num_actuators: A.
        max_steps: Time limit.
        stagger: Spread the first time-outs over the environments, to cut episodes inside rollouts.
        auto_reset: Reset an ended episode in the same step; False steps on like a plain environment.
        gripper: Actions hold a fourth number per actuator, which should be 1 where the goal is up.
        break_at: Step count at which the reward ("reward") or observation ("obs") turns NaN.
    """

    PROGRESS = SimpleNamespace(name="mean_distance", unit="m")

    def __init__(self, num_envs, num_actuators=2, max_steps=10, stagger=False, auto_reset=True, gripper=False, break_at=None):
        self.gripper = gripper
        self.num_envs, self.num_actuators, self.max_steps = num_envs, num_actuators, max_steps
        self.stagger, self.auto_reset = stagger, auto_reset
        self.break_at = break_at or (-1, "")
        self.total_steps = 0
        self.unwrapped = self

    def reset(self, seed):
        """Draw goals; row i depends on seed[i] alone."""
        assert len(seed) == self.num_envs
        self._rngs = [torch.Generator().manual_seed(s) for s in seed]
        self.position = torch.zeros(self.num_envs, self.num_actuators, 3)
        self.goal = torch.zeros_like(self.position)
        self.elapsed = torch.zeros(self.num_envs, dtype=torch.int64)
        self.returns = torch.zeros(self.num_envs)
        self.once = torch.zeros(self.num_envs, dtype=torch.bool)
        self._restart(torch.ones(self.num_envs, dtype=torch.bool))
        if self.stagger:
            self.elapsed = torch.arange(self.num_envs) % self.max_steps
        return self._obs(), {}

    def step(self, action):
        """Move the actuators; never terminates, only times out."""
        self.total_steps += 1
        action = action.view(self.num_envs, self.num_actuators, 4 if self.gripper else 3)
        grip_is_right = (action[..., -1] > 0) == (self.goal[..., 2] > 0)
        action = action[..., :3]
        action = action / action.norm(dim=-1, keepdim=True).clamp(min=1.0)
        self.position = self.position + STEP_SIZE * action
        self.elapsed = self.elapsed + 1
        distance = (self.goal - self.position).norm(dim=-1).mean(-1)
        reward = 1.0 - torch.tanh(3.0 * distance)
        if self.gripper:
            reward = 0.5 * (reward + grip_is_right.float().mean(-1))
        if self.break_at == (self.total_steps, "reward"):
            reward[0] = torch.nan
        success = distance < 0.1
        self.returns, self.once = self.returns + reward, self.once | success
        truncated = self.elapsed >= self.max_steps
        terminated = torch.zeros_like(truncated)
        info = {
            "success": success,
            "mean_distance": distance,
            "episode": {
                "return": self.returns.clone(),
                "success_once": self.once.clone(),
                "success_at_end": success,
                "episode_len": self.elapsed.clone(),
            },
        }
        obs = self._obs()
        if truncated.any() and self.auto_reset:
            final = {"final_observation": obs, "final_info": info, "_final_info": truncated}
            self._restart(truncated)
            obs, info = self._obs(), final
        return obs, reward, terminated, truncated, info

    def _restart(self, mask):
        for i in mask.nonzero().flatten().tolist():
            shape = (self.num_actuators, 3)
            self.position[i] = torch.randn(shape, generator=self._rngs[i]) * 0.1
            self.goal[i] = torch.randn(shape, generator=self._rngs[i]) * 0.3
        self.elapsed[mask], self.returns[mask], self.once[mask] = 0, 0.0, False

    def _obs(self):
        offset = self.goal - self.position
        nodes = {
            "position": self.position.clone(),
            "vectors": offset.unsqueeze(2),
            "scalars": offset.norm(dim=-1, keepdim=True),
            "mask": torch.ones(self.num_envs, self.num_actuators, dtype=torch.bool),
        }
        if self.break_at == (self.total_steps, "obs"):
            nodes["vectors"][0] = torch.nan
        neighbors = torch.full((self.num_envs, self.num_actuators, 1), -1)
        gravity = torch.tensor([0.0, 0.0, -9.81]).expand(self.num_envs, 3)
        return {"graph": {"object": {**nodes, "neighbors": neighbors}, "actuator": nodes, "gravity": gravity}}


class ToyPolicy(nn.Module):
    """Every actuator decides by itself from its goal offset; the interface of a real policy."""

    def __init__(self, seed=0, hidden_dim=16, gripper=False):
        super().__init__()
        self.schema = SCHEMA
        self.config = {"name": "toy", "schema": SCHEMA.to_dict(), "options": {"hidden_dim": hidden_dim}}
        self.normalizer = GraphNormalizer(SCHEMA)
        with torch.random.fork_rng():
            torch.manual_seed(seed)
            self.trunk = nn.Sequential(nn.Linear(4, hidden_dim), nn.Tanh())
            self.mean = nn.Linear(hidden_dim, 3)
            self.gripper = nn.Linear(4, 1) if gripper else None
            self.critic = nn.Sequential(nn.Linear(4, hidden_dim), nn.Tanh(), nn.Linear(hidden_dim, 1))
        nn.init.zeros_(self.mean.weight)
        self.log_std = nn.Parameter(torch.tensor(-0.5))

    def prepare(self, graph):
        """Return scaled graphs."""
        return self.normalizer(graph)

    def forward(self, graph):
        """Return distribution and value."""
        return self.evaluate(self.prepare(graph))

    def evaluate(self, graph, *, actor=True, critic=True):
        """Return distribution and value of scaled graphs."""
        nodes = graph["actuator"]
        x = torch.cat([nodes["vectors"].flatten(2), nodes["scalars"]], -1)
        mean = self.mean(self.trunk(x))
        std = self.log_std.exp().expand(mean.shape[:-1]).unsqueeze(-1)
        logits = None if self.gripper is None else self.gripper(x).squeeze(-1)
        dist = ActionDistribution(mean, std, nodes["mask"], logits)
        return dist, self.critic(x).mean((1, 2))

    def distribution(self, graph):
        """Return the distribution alone."""
        return self(graph)[0]

    def value(self, graph):
        """Return the value alone."""
        return self(graph)[1]

    def rescale_value(self, factor, shift):
        """Change the last layer of the value function."""
        with torch.no_grad():
            self.critic[-1].weight.mul_(factor)
            self.critic[-1].bias.mul_(factor).add_(shift)

    def act(self, graph, deterministic=False, generator=None):
        """Return actions."""
        dist = self.distribution(graph)
        return dist.mode if deterministic else dist.sample(generator)
