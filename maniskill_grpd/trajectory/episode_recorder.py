"""ManiSkill's recorder, for one agent or several."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from mani_skill.utils import common
from mani_skill.utils.wrappers import RecordEpisode
from mani_skill.utils.wrappers.flatten import FlattenActionSpaceWrapper


class EpisodeRecorder(RecordEpisode):
    """Records episodes as ManiSkill's `RecordEpisode` does; actions of several agents too.

    ManiSkill's wrapper stops with an error where actions are dictionaries. Here they are written side by side, in the order of
    the agents, as the replay expects them; `step` takes a dictionary or such a row.
    """

    def __init__(self, env: gym.Env, output_dir: str | Path, **settings: Any) -> None:
        """Wrap an environment.

        Args:
            env: What is recorded.
            output_dir: Folder of the files.
            settings: As `RecordEpisode` takes them.
        """
        self._agents = tuple(env.action_space) if isinstance(env.action_space, gym.spaces.Dict) else ()
        super().__init__(FlattenActionSpaceWrapper(env) if self._agents else env, str(output_dir), **settings)
        if self.save_trajectory:
            self._h5_path = Path(self._h5_file.filename)

    def step(self, action: Any) -> tuple[Any, Any, Any, Any, dict]:
        """Take a step, recorded."""
        if self._agents and isinstance(action, Mapping):
            action = torch.cat([common.to_tensor(action[agent]) for agent in self._agents], dim=-1)
        return super().step(action)

    @property
    def path(self) -> Path:
        """The file of the trajectories."""
        return self._h5_path

    def keep(self, worlds: np.ndarray) -> None:
        """Write the episodes of some worlds (b,)."""
        self.flush_trajectory(env_idxs_to_flush=worlds)

    def drop(self, worlds: np.ndarray | None = None) -> None:
        """Forget the episodes of some worlds (b,), or of all: without that, the next ones would be appended to them."""
        self.flush_trajectory(env_idxs_to_flush=worlds, save=False)

    def discard(self) -> None:
        """Close, and remove the trajectory that was being written."""
        self.close()
        if self.save_trajectory:
            for file in (self._h5_path, Path(self._json_path)):
                file.unlink(missing_ok=True)
