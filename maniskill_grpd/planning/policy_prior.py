"""A policy as the starting point of plans."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

from maniskill_grpd.learning import CheckpointError, TrainConfig
from maniskill_grpd.learning.value_scale import ValueScale
from maniskill_grpd.planning.sample_worlds import SampleWorlds, State
from maniskill_grpd.policies import Policy
from maniskill_grpd.runs.checkpoints import check_schema, load_policy


class PolicyPrior:
    """Proposes what a policy would do, and may stand for the future after a plan with its value function.

    Args:
        policy: The policy.
        value_scale: Scale of its values; None for a policy whose values were never trained.
        trained: Options of its training.
    """

    def __init__(self, policy: Policy, value_scale: ValueScale | None, trained: TrainConfig) -> None:
        self.policy = policy
        self.value_scale = value_scale
        self.trained = trained
        self.discount = trained.gamma

    @classmethod
    def load(cls, path: Path, *, allow_import: bool = False) -> PolicyPrior:
        """Read a checkpoint; errors as of `load_policy`."""
        policy, contents = load_policy(path, allow_import=allow_import)
        scale = ValueScale()
        scale.load_state_dict(contents["value_scale"])
        is_trained = contents["value_scale"]["weight"] > 0.0
        return cls(policy, scale if is_trained else None, TrainConfig.from_dict(contents["train_config"]))

    def check(self, env: gym.Env) -> None:
        """Refuse an environment whose graphs the policy does not understand.

        Raises:
            CheckpointError: Naming what differs.
        """
        if "graph" not in str(env.unwrapped.obs_mode).split("+"):
            raise CheckpointError(f"a prior looks at graphs: obs_mode must be graph, got {env.unwrapped.obs_mode!r}")
        check_schema(self.policy, env)
        width = 4 if self.policy.config["options"].get("gripper") else 3
        needed = math.prod(env.unwrapped.single_action_space.shape) // env.unwrapped.num_grippers
        if width != needed:
            raise CheckpointError(f"the policy gives {width} numbers for each gripper, and this task takes {needed}")

    def propose(self, worlds: SampleWorlds, state: State, horizon: int) -> torch.Tensor:
        """Return the mean actions of the policy from the states of E episodes on, (E, H, D)."""
        worlds.enter(state)
        plan = []
        for _ in range(horizon):
            action = self.policy.act(worlds.observe()["graph"], deterministic=True)
            plan.append(action)
            worlds.step(action[:, None].expand(-1, worlds.samples, -1))
        return torch.stack(plan, dim=1)

    @torch.no_grad()
    def value(self, obs: Any) -> torch.Tensor:
        """Return the discounted return that is expected from observations of B worlds on, (B,)."""
        assert self.value_scale is not None
        return self.value_scale.denormalize(self.policy.value(obs["graph"])).float()
