"""The window of `render_mode="human"` where SAPIEN cannot draw: a page that a browser shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mani_skill import logger

from maniskill_grpd.tasks.pictures.dragging import Dragging
from maniskill_grpd.tasks.pictures.world_parts import WorldParts
from maniskill_grpd.viewer.scene import Scene
from maniskill_grpd.viewer.server import address_of, open_server

if TYPE_CHECKING:
    from maniskill_grpd.tasks.pictures.world_pictures import WorldPictures

MOST_WORLDS = 16
"""How many worlds are shown at most."""


class BrowserWindow:
    """The worlds of an environment on a page, where they can be pulled at with the mouse.

    Nothing runs behind the back of the environment: the page shows, and mice pull, what is so when `show` is called.

    Args:
        env: The environment; at most its first 16 worlds are shown.

    Raises:
        ValueError: If viser is missing.
    """

    def __init__(self, env: WorldPictures) -> None:
        self._parts = WorldParts(env, range(min(env.num_envs, MOST_WORLDS)))
        self._dragging = Dragging(self._parts)
        self._scene = Scene(open_server())
        self._scene.look_from(*self._parts.viewpoint)
        self.address = address_of(self._scene.server)
        """Where a browser finds it."""
        logger.warning(f"SAPIEN cannot draw here; open {self.address} in a browser")

    def show(self) -> None:
        """Pull as the mice do, and show the worlds as they are now."""
        self._dragging.follow(self._scene.take_drags())
        self._scene.show(self._parts.parts())

    def close(self) -> None:
        """Stop the server."""
        self._dragging.let_go()
        self._scene.server.stop()
