"""Handles in the scene by which grippers are moved by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from maniskill_grpd.playing.agents import Teleoperator
from maniskill_grpd.playing.player import Player
from maniskill_grpd.tasks.pictures.dragging import REACH
from maniskill_grpd.tasks.pictures.world_parts import WorldParts

if TYPE_CHECKING:
    import viser

SIZE = 0.12
"""Length of the arrows [m]."""


class Gizmos:
    """One gizmo for each gripper of the world that is tele-operated, where that is.

    Args:
        player: Its agent is led by the gizmos, if it is a `Teleoperator`.
        server: Where they are drawn.
    """

    def __init__(self, player: Player, server: viser.ViserServer) -> None:
        self._player, self._server = player, server
        self._handles: list[Any] = []
        self._offset = np.zeros(3)

    def take_over(self, world: int, parts: WorldParts) -> None:
        """Put gizmos to the grippers of a world, or remove them where nobody is tele-operated."""
        agent = self._player.agent
        if not isinstance(agent, Teleoperator):
            self._resize(0)
            return
        agent.take_over(world)
        self._offset = parts.offset_of(world)
        self._resize(len(agent.targets))
        for handle, target in zip(self._handles, agent.targets.cpu().numpy(), strict=True):
            handle.position = target + self._offset

    def grip(self, gripper: int, is_closed: bool) -> None:
        """Open or close a gripper that is tele-operated.

        Raises:
            ValueError: If there is none, or it cannot open.
        """
        agent = self._player.agent
        if not isinstance(agent, Teleoperator):
            raise ValueError("grippers are opened and closed by hand by the agent teleop")
        if not agent.has_grip:
            raise ValueError('grippers of this task hold on for the whole episode; with grasp="free" they open and close')
        if not 0 <= gripper < len(agent.closed):
            raise ValueError(f"gripper must be in [0, {len(agent.closed) - 1}], got {gripper}")
        agent.closed[gripper] = is_closed

    def _lead(self, gripper: int, position: np.ndarray) -> None:
        """Let a gripper go to a point (3,) of the scene."""
        agent = self._player.agent
        if not isinstance(agent, Teleoperator) or gripper >= len(agent.targets):
            return  # a message from before the agent changed
        target = position - self._offset
        if not np.isfinite(target).all():
            raise ValueError("a gizmo points nowhere: its place is not finite; nothing was moved")
        distance = float(np.linalg.norm(target))
        if distance > REACH:
            self._player.tell(f"grippers go no further than {REACH} m from the middle of a world")
        agent.targets[gripper] = torch.as_tensor(target * min(1.0, REACH / max(distance, REACH)))

    def _resize(self, count: int) -> None:
        while len(self._handles) > count:
            self._handles.pop().remove()
        while len(self._handles) < count:
            self._handles.append(self._add(len(self._handles)))

    def _add(self, gripper: int) -> Any:
        settings = {"scale": SIZE, "disable_rotations": True, "depth_test": False}
        handle = self._server.scene.add_transform_controls(f"/gizmos/{gripper}", **settings)

        @handle.on_update
        async def _(event: Any) -> None:
            position = np.array(event.target.position)
            self._player.ask(lambda: self._lead(gripper, position))

        return handle
