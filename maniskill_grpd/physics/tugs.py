"""Pulling a node of a world from outside, compliantly, whatever grippers do."""

from __future__ import annotations

import math

import torch

from maniskill_grpd.physics.world_state import WorldState


class Tugs(WorldState):
    """The state of all worlds, and who pulls at them; see `Solver`."""

    def tug(self, world: int, node: int, target: torch.Tensor, stiffness: float) -> None:
        """Pull a node to a point with a spring, until `let_go` or a reset; a new tug replaces that of its world.

        Nodes that grippers hold do not follow. A tug is no part of a saved state. The spring pulls once in a substep h, before
        the object resists: with the mass m of the node it gives way by 1 / stiffness + h^2 / m under a steady force of 1 N.

        Args:
            world: Which world.
            node: Which of its nodes.
            target: Where to, (3,) [m].
            stiffness: Of the spring, > 0 [N/m].

        Raises:
            ValueError: If there is no such world or node, or a number is not finite or out of its range.
        """
        if not 0 <= world < self.num_worlds:
            raise ValueError(f"world must be in [0, {self.num_worlds - 1}], got {world}")
        count = int(self.node_mask[world].sum())
        if not 0 <= node < count:
            raise ValueError(f"node must be in [0, {count - 1}], got {node}")
        if tuple(target.shape) != (3,) or not torch.isfinite(target).all():
            raise ValueError(f"target must be three finite numbers, got {target.tolist()}")
        if not (stiffness > 0.0 and math.isfinite(stiffness)):
            raise ValueError(f"stiffness must be finite and > 0 N/m, got {stiffness}")
        self.tug_targets[world] = target.to(self.tug_targets)
        self.tug_stiffnesses[world] = stiffness
        self.tug_nodes[world] = node

    def let_go(self, world_idx: torch.Tensor) -> None:
        """End the tugs in some worlds (b,) int64."""
        self.tug_nodes[world_idx] = -1
