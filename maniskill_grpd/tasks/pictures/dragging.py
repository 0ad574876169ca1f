"""Hands of clients in the worlds: whoever drags the object with the mouse pulls its nearest node with a spring."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import torch

from maniskill_grpd.tasks.pictures.world_parts import WorldParts
from maniskill_grpd.viewer.drag import Drag

STIFFNESS = 60.0
"""Of the spring between mouse and node [N/m]: a cloth of 50 g hangs about a centimetre below the mouse."""
REACH = 1.5
"""How far from the origin of its world somebody can pull [m]."""


@dataclass(frozen=True)
class _Hold:
    world: int
    node: int
    offset: np.ndarray
    """From the node to where it was taken hold of, (3,) [m]."""


class Dragging:
    """Turns what clients do with the mouse into tugs of the solver; each client holds at most one node, each world is held once.

    Args:
        parts: Knows where the worlds are in the scene.
    """

    def __init__(self, parts: WorldParts) -> None:
        self._parts = parts
        self._holds: dict[int, _Hold] = {}

    def follow(self, drags: Iterable[Drag]) -> list[str]:
        """Pull as clients do; return what they have to be told."""
        messages = [self._follow(drag) for drag in drags]
        return [message for message in messages if message]

    def let_go(self) -> None:
        """End all that is held."""
        for client in list(self._holds):
            self._release(client)

    def _follow(self, drag: Drag) -> str:
        if drag.phase == "end":
            self._release(drag.client)
            return ""
        if not (np.isfinite(drag.hit).all() and np.isfinite(drag.pointer).all()):
            return "the mouse points nowhere: its place is not finite; nothing was moved"
        if drag.client not in self._holds:
            self._holds[drag.client] = self._take(drag.hit)
        return self._pull(self._holds[drag.client], drag.pointer)

    def _take(self, hit: np.ndarray) -> _Hold:
        """Take hold of the node that is nearest to a point (3,) of the scene."""
        solver = self._parts.env.solver
        world, point = self._parts.locate(hit)
        for client, hold in list(self._holds.items()):
            if hold.world == world:
                self._release(client)
        nodes = self._parts.env.nodes_of(world, solver.positions)
        node = int(np.linalg.norm(nodes - point, axis=1).argmin())
        return _Hold(world, node, point - nodes[node])

    def _pull(self, hold: _Hold, pointer: np.ndarray) -> str:
        target = pointer - self._parts.offset_of(hold.world) - hold.offset
        distance = float(np.linalg.norm(target))
        solver = self._parts.env.solver
        solver.tug(hold.world, hold.node, torch.as_tensor(target * min(1.0, REACH / max(distance, REACH))), STIFFNESS)
        return f"nobody pulls further than {REACH} m from the middle of a world" if distance > REACH else ""

    def _release(self, client: int) -> None:
        hold = self._holds.pop(client, None)
        if hold is not None:
            solver = self._parts.env.solver
            solver.let_go(torch.tensor([hold.world], device=solver.device))
