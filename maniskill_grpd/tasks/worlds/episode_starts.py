"""What tasks start episodes with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv

from maniskill_grpd.physics import Solver
from maniskill_grpd.tasks.worlds.choices import as_choice
from maniskill_grpd.tasks.worlds.variant_tables import node_table, variant_table


class EpisodeStarts(BaseEnv):
    """The part of an environment that serves a task's `allocate_episode` and `start_episode`: random numbers, and tables."""

    num_grippers: int
    solver: Solver
    start_nodes: torch.Tensor

    def draw_choice(self, worlds: torch.Tensor, num: int) -> torch.Tensor:
        """Draw one of `num` possibilities for some worlds, (b,) int64; without a draw where there is but one."""
        if num == 1:
            return torch.zeros_like(worlds)
        (draws,) = self.draw_uniform(worlds, 1)
        return as_choice(draws[:, 0], num)

    def draw_uniform(self, worlds: torch.Tensor, *sizes: int) -> tuple[torch.Tensor, ...]:
        """Draw numbers in [-1, 1) for some worlds (b,), from each one's generator: one tensor (b, size) per size."""
        draws = self._batched_episode_rng[worlds.cpu().numpy()].uniform(-1.0, 1.0, size=sum(sizes))
        return torch.as_tensor(draws, dtype=torch.float32, device=self.device).split(sizes, dim=1)

    @property
    def variants(self) -> torch.Tensor:
        """Index in `models` of the object of each world, (B,) int64."""
        return self.solver.variants.long()

    def node_table(self, tables: Sequence[np.ndarray]) -> torch.Tensor:
        """Stack what the nodes of each variant have, (n_m, ...), into (M, N, ...), with zeros in the padding."""
        return node_table(tables, self.solver.num_nodes, self.device)

    def variant_table(self, tables: Sequence[np.ndarray]) -> torch.Tensor:
        """Stack other tables of the variants, (n_m, ...), into (M, n, ...); short ones repeat their last rows."""
        return variant_table(tables, self.device)

    def at_start_nodes(self, values: torch.Tensor) -> torch.Tensor:
        """Return what the nodes at which the grippers started have of values (B, N, ...), (B, A, ...)."""
        return values[torch.arange(len(values), device=values.device)[:, None], self.start_nodes]

    def _check_start(self, worlds: torch.Tensor, positions: torch.Tensor, nodes: torch.Tensor) -> None:
        """Refuse a start that the solver would not survive."""
        name, count = f"{type(self).__name__}.start_episode()", len(worlds)
        for what, value, shape in (
            ("positions", positions, (count, self.solver.num_nodes, 3)),
            ("nodes of the grippers", nodes, (count, self.num_grippers)),
        ):
            if tuple(value.shape) != shape:
                raise ValueError(f"{name} must return {what} {shape}, got {tuple(value.shape)}")
        if not bool(torch.isfinite(positions).all()):
            raise ValueError(f"{name} must return finite positions, also in the padding")
        size = self.solver.node_mask[worlds].sum(dim=1, keepdim=True)
        if bool(((nodes < 0) | (nodes >= size)).any()):
            raise ValueError(f"{name} starts grippers at nodes {nodes.tolist()}; the objects have {size[:, 0].tolist()} nodes")
