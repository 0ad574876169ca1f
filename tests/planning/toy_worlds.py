"""A batched environment whose best plan is known: a mass on a line of which an action is the displacement."""

from types import SimpleNamespace

import gymnasium as gym
import torch


class ToyWorlds:
    """State x in R^2 per world; x' = x + a, reward -|x' - goal|^2; nothing else."""

    GOAL = torch.tensor([1.5, -0.8])

    def __init__(self, num_envs: int, forgets: bool = False, has_noise: bool = False, control_mode: str = "pd_ee_delta_pos"):
        self.num_envs, self.device, self.control_mode, self.obs_mode = num_envs, torch.device("cpu"), control_mode, "none"
        self.single_action_space = gym.spaces.Box(-1.0, 1.0, (2,))
        self.unwrapped = self
        self.spec = SimpleNamespace(id="Toy")
        self._forgets, self._has_noise = forgets, has_noise
        self.x = torch.zeros(num_envs, 2)

    def reset(self, seed=None):
        """Go to the origin."""
        self.x = torch.zeros(self.num_envs, 2)
        return {}, {}

    def step(self, action):
        """Move by an action."""
        self.x = self.x + action + (torch.randn(2) if self._has_noise else 0.0)
        reward = -(self.x - self.GOAL).square().sum(-1)
        return {"x": self.x}, reward, None, None, {}

    def get_obs(self):
        """Show the state."""
        return {"x": self.x}

    def get_state_dict(self):
        """Return a copy of the state."""
        return {"mass": {"x": self.x.clone()}}

    def set_state_dict(self, state):
        """Restore a state."""
        if not self._forgets:
            self.x = state["mass"]["x"].clone()

    def close(self):
        """Do nothing."""
