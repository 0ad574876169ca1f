"""Demonstrations: observation graphs with the actions an expert takes in them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import h5py
import torch
from tqdm import tqdm

from maniskill_grpd.experts import make_expert
from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.learning.rollout import Graph, map_graph


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """M observations in E episodes."""

    graph: Graph
    """Raw observation graphs, (M, ...) per tensor."""
    actions: torch.Tensor
    """What the expert does there, (M, A, 3), in units of the largest displacement per step; (M, A, 4) where grippers open (0) and
    close (1), the last."""
    episode: torch.Tensor
    """Episode that each observation is from, in the order of its steps, (M,) int64."""
    rewards: torch.Tensor | None = None
    """What each action brought, (M,); None where that was not recorded."""

    @property
    def num_episodes(self) -> int:
        """Number of episodes E."""
        return int(self.episode.max()) + 1

    def returns(self, discount: float) -> torch.Tensor:
        """Return the discounted sum of the rewards from each observation on, (M,).

        A time limit is no end, as for the values of a training: the last reward of an episode is taken to go on for ever, which
        needs a discount below 1.

        Raises:
            ValueError: If there are no rewards.
        """
        if self.rewards is None:
            raise ValueError("the demonstrations have no rewards")
        returns, rewards, episodes = torch.empty_like(self.rewards), self.rewards.tolist(), self.episode.tolist()
        following = 0.0
        for index in reversed(range(len(rewards))):
            if index + 1 == len(rewards) or episodes[index + 1] != episodes[index]:
                following = rewards[index] / (1.0 - discount) if discount < 1.0 else 0.0
            following = rewards[index] + discount * following
            returns[index] = following
        return returns

    def select(self, index: torch.Tensor) -> tuple[Graph, torch.Tensor]:
        """Return the graphs and actions at positions (m,)."""
        return map_graph(lambda tensor: tensor[index], self.graph), self.actions[index]

    def split(self, num_held_out: int, generator: torch.Generator) -> tuple[torch.Tensor, ...]:
        """Positions of the observations of most episodes, and of `num_held_out` other episodes."""
        order = torch.randperm(self.num_episodes, generator=generator)
        is_held_out = torch.isin(self.episode, order[:num_held_out])
        return (~is_held_out).nonzero()[:, 0], is_held_out.nonzero()[:, 0]


@torch.no_grad()
def record_demonstrations(
    env: gym.Env, env_id: str, seeds: list[int], *, num_steps: int, action_noise: float, generator: torch.Generator
) -> Demonstrations:
    """Let the expert of a task act and record what it does.

    What is recorded is the expert's action, what is executed is that action plus noise: so the
    demonstrations show how to come back from where an imperfect learner gets (Laskey et al. 2017,
    DART, arXiv:1703.09327).

    Args:
        env: The task with graph observations, B worlds.
        env_id: Its id.
        seeds: One per episode.
        num_steps: Steps of an episode that are recorded; the expert is done early.
        action_noise: Standard deviation of the noise per axis, in units of the largest action.
        generator: Source of the noise.

    Returns:
        len(seeds) * num_steps observations on the CPU.
    """
    expert = make_expert(env_id, env)
    num_worlds = env.unwrapped.num_envs
    graphs, actions, episodes = [], [], []
    for first in tqdm(range(0, len(seeds), num_worlds), desc="demonstrations", unit="batch"):
        chunk = seeds[first : first + num_worlds]
        obs, _ = env.reset(seed=chunk + [chunk[-1]] * (num_worlds - len(chunk)))
        for _ in range(num_steps):
            action = expert.act()
            graphs.append(_first_on_cpu(obs["graph"], len(chunk)))
            actions.append(action[: len(chunk)].cpu())
            episodes.append(torch.arange(first, first + len(chunk)))
            noise = torch.randn(action.shape, generator=generator).to(action)
            obs, *_ = env.step(action + action_noise * noise)
    return Demonstrations(
        graph=_concatenate(graphs), actions=torch.cat(actions).unflatten(1, (-1, 3)), episode=torch.cat(episodes)
    )


def load_demonstrations(path: Path, schema: GraphSchema, *, has_grippers: bool = False) -> Demonstrations:
    """Read trajectories that ManiSkill's RecordEpisode wrote with graph observations.

    Args:
        path: The .h5 file.
        schema: What the graphs must hold.
        has_grippers: Whether actions have a fourth number per gripper, which closes (1) or opens (0) it.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds no trajectories with graphs, or graphs that do not fit the schema.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no trajectories at {path}")
    graphs, actions, episodes, rewards = [], [], [], []
    with h5py.File(path) as file:
        names = [name for name in file if f"{name}/obs/graph" in file]
        if not names:
            raise ValueError(
                f'{path} holds no trajectories with graph observations; record with obs_mode="graph" and RecordEpisode'
            )
        for number, name in enumerate(names):
            taken = torch.from_numpy(file[name]["actions"][:]).float()
            # There is one observation more than there are actions: the last.
            graphs.append(_read_graph(file[name]["obs/graph"], len(taken)))
            actions.append(taken.unflatten(1, (-1, 4 if has_grippers else 3)))
            episodes.append(torch.full((len(taken),), number))
            if "rewards" in file[name]:
                rewards.append(torch.from_numpy(file[name]["rewards"][:]).float())
    graph = _concatenate(graphs)
    schema.validate(graph, values=True)
    # Recorded actions are what was asked for; the controller limits their length.
    motion, grip = torch.cat(actions).tensor_split([3], dim=-1)
    motion = motion / torch.linalg.vector_norm(motion, dim=-1, keepdim=True).clamp(min=1.0)
    # The controller opens below a half.
    wanted = torch.cat([motion, (grip > 0.5).float()], dim=-1)
    has_rewards = len(rewards) == len(episodes)
    return Demonstrations(
        graph=graph, actions=wanted, episode=torch.cat(episodes), rewards=torch.cat(rewards) if has_rewards else None
    )


def _first_on_cpu(graph: Graph, num: int) -> Graph:
    return map_graph(lambda tensor: tensor[:num].cpu(), graph)


def _read_graph(group: Any, num: int) -> Graph:
    return {
        key: _read_graph(value, num) if isinstance(value, h5py.Group) else torch.from_numpy(value[:num])
        for key, value in group.items()
    }


def _concatenate(graphs: list[Graph]) -> Graph:
    return {
        key: _concatenate([graph[key] for graph in graphs])
        if isinstance(value, dict)
        else torch.cat([graph[key] for graph in graphs])
        for key, value in graphs[0].items()
    }
