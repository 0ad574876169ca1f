"""Worlds whose whole state can be read, restored and moved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch

from maniskill_grpd.physics import Solver
from maniskill_grpd.tasks.worlds.batched_scene import BatchedScene
from maniskill_grpd.tasks.worlds.embodied_worlds import EmbodiedWorlds
from maniskill_grpd.tasks.worlds.episode_tensors import EpisodeTensors
from maniskill_grpd.tasks.worlds.measured_worlds import MeasuredWorlds
from maniskill_grpd.tasks.worlds.rigid_motion import checked_motion, move_solver
from maniskill_grpd.tasks.worlds.state_layout import StateDict, read_flat, read_rows


class RestorableWorlds(EmbodiedWorlds, MeasuredWorlds):
    """The part of an environment that knows everything on which the future of its worlds depends.

    ManiSkill's own methods forget custom groups of a flat state and the targets of controllers.
    """

    scene: BatchedScene
    solver: Solver
    """State of all worlds."""
    start_nodes: torch.Tensor
    """Node that each gripper held at the start of the episode, (B, A) int64."""
    _episode: EpisodeTensors

    def get_state_dict(self) -> StateDict:
        """Return everything that the future depends on, as copies; leaves (B, D)."""
        state = super().get_state_dict()
        state["solver"] = self.solver.state()
        state["episode"] = {"start_nodes": self.start_nodes.float(), **self._episode.state()}
        return state

    def set_state_dict(self, state: Mapping[str, Any], env_idx: Any = None) -> None:
        """Restore what `get_state_dict` returned.

        Args:
            state: Leaves are numpy or torch, one row per world; or (D,) for a single world. "controller" may be left out: the
                solver's state has the targets too.
            env_idx: Worlds to restore, in the order of the rows; all by default.

        Raises:
            ValueError: If the state does not fit.
        """
        worlds = self._world_indices(env_idx)
        template = self.get_state_dict()
        if "controller" not in state:
            del template["controller"]
        self._write_state(read_rows(state, template, len(worlds)), worlds)

    def set_state(self, state: Any, env_idx: Any = None) -> None:
        """Restore what `get_state` returned: rows (b, D), or (D,) for a single world."""
        worlds = self._world_indices(env_idx)
        self._write_state(read_flat(state, self.get_state_dict(), len(worlds)), worlds)

    def _world_indices(self, env_idx: Any) -> torch.Tensor:
        """Return the indices (b,) of worlds that are given by indices or a mask (B,); all for None.

        Raises:
            ValueError: If there is no such world.
        """
        if env_idx is None:
            return torch.arange(self.num_envs, device=self.device)
        worlds = torch.atleast_1d(torch.as_tensor(env_idx, device=self.device))
        if worlds.dtype == torch.bool and worlds.shape == (self.num_envs,):
            return worlds.nonzero()[:, 0]
        is_index = not len(worlds) or not (worlds.is_floating_point() or worlds.dtype == torch.bool)
        if worlds.ndim != 1 or not is_index or not ((worlds >= 0) & (worlds < self.num_envs)).all():
            raise ValueError(f"env_idx must be indices in [0, {self.num_envs}) or a mask ({self.num_envs},), got {env_idx}")
        return worlds.long()

    def _check_state(self, state: StateDict, worlds: torch.Tensor) -> None:
        """Check everything that is an index or has a range, before anything is written.

        Raises:
            ValueError: If a value is out of its range.
        """
        self.solver.check_state(state["solver"], worlds)
        nodes, start_nodes = self.solver.num_nodes, state["episode"]["start_nodes"]
        is_node = (start_nodes == start_nodes.floor()) & (start_nodes >= 0) & (start_nodes < nodes)
        if not is_node.all():
            raise ValueError(f"start_nodes must be whole numbers in [0, {nodes - 1}], got {start_nodes[~is_node][0].item():g}")

    def _write_state(self, state: StateDict, worlds: torch.Tensor) -> None:
        self._check_state(state, worlds)
        self.solver.set_state(state["solver"], worlds)
        self.scene.grip_commands[worlds] = self.solver.closed[worlds]
        for agent in self._agents:
            agent.robot.set_state(state["articulations"][agent.robot.name], worlds)
        self.start_nodes[worlds] = state["episode"]["start_nodes"].long()
        self._episode.set_state(state["episode"], worlds)
        self.forget_measurement()

    def move_worlds(self, rotation: torch.Tensor, translation: torch.Tensor) -> None:
        """Move all worlds rigidly until their next reset, x -> R x + t: the same episodes, seen from elsewhere.

        Object, grippers, table, obstacles, gravity and what belongs to the episode move together.
        Actions that are rotated likewise then bring the rotated trajectory, and equal rewards.

        Args:
            rotation: Rotation matrices, (3, 3) or (B, 3, 3).
            translation: (3,) or (B, 3) [m].

        Raises:
            ValueError: If a matrix is no rotation (a reflection or a scaling for example), or a number is not finite. Nothing
                has moved then.
        """
        rotation, translation = checked_motion(rotation, translation, self.num_envs)
        rotation, translation = rotation.to(self.solver.positions), translation.to(self.solver.positions)
        move_solver(self.solver, rotation, translation)
        self._episode.move(rotation, translation)
        for agent in self._agents:
            agent.robot.move(rotation, translation)
        self.forget_measurement()
