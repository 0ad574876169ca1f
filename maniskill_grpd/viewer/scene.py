"""Parts in the scene of a viser server, kept up to date for all its clients."""

from __future__ import annotations

import queue
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from maniskill_grpd.viewer.drag import Drag
from maniskill_grpd.viewer.parts import Color, Copies, Look, Part, Shell, same_array, same_mesh

if TYPE_CHECKING:
    import viser

ROOT = "/worlds"
"""Node of the scene below which all parts are."""


class Scene:
    """Parts on a server.

    All methods are called by one thread, that of the simulation. What clients do waits in queues until it is asked for.

    Args:
        server: Where clients look at the scene.
        draggable: Names of the parts that can be pulled at with the mouse.
    """

    def __init__(self, server: viser.ViserServer, draggable: tuple[str, ...] = ("object",)) -> None:
        self.server = server
        self._draggable = draggable
        self._drags: queue.SimpleQueue[Drag] = queue.SimpleQueue()
        self._shown: dict[str, tuple[Part, list[Any]]] = {}
        server.scene.set_up_direction("+z")
        server.scene.configure_default_lights(cast_shadow=False)
        server.on_client_disconnect(self._forget_client)

    def show(self, parts: Mapping[str, Part]) -> None:
        """Let all clients see these parts, and no others; only what has changed is sent."""
        with self.server.atomic():
            for name in self._shown.keys() - parts.keys():
                self._remove(name)
            for name, part in parts.items():
                self._show_part(name, part)

    def take_drags(self) -> Iterator[Drag]:
        """Yield what clients have done with the mouse since the last call."""
        for _ in range(self._drags.qsize()):
            yield self._drags.get_nowait()

    def look_from(self, position: np.ndarray, target: np.ndarray, fov: float) -> None:
        """Move the cameras of all clients, also of those that come later: places (3,) [m], vertical field of view [rad]."""
        initial = self.server.initial_camera
        initial.position, initial.look_at = tuple(map(float, position)), tuple(map(float, target))
        initial.fov = fov
        for client in self.server.get_clients().values():
            client.camera.position, client.camera.look_at, client.camera.fov = initial.position, initial.look_at, initial.fov

    def _show_part(self, name: str, part: Part) -> None:
        shown = self._shown.get(name)
        if shown is None or not same_mesh(shown[0], part):
            self._remove(name)
            self._shown[name] = (part, self._add(name, part))
            return
        before, handles = shown
        if before is part:
            return
        if isinstance(part, Shell):
            if not same_array(before.vertices, part.vertices):
                for handle in handles:
                    handle.vertices = part.vertices
        elif not (same_array(before.positions, part.positions) and same_array(before.rotations, part.rotations)):
            for handle in handles:
                handle.batched_positions, handle.batched_wxyzs = part.positions, part.rotations
        self._shown[name] = (part, handles)

    def _remove(self, name: str) -> None:
        if name in self._shown:
            for handle in self._shown.pop(name)[1]:
                handle.remove()

    def _add(self, name: str, part: Part) -> list[Any]:
        """Build a part: one mesh, or one for each side where these differ in colour."""
        look = part.look
        sides = [("front", look.front), ("back", look.back)] if look.back is not None else [("double", look.front)]
        handles = [self._add_side(f"{ROOT}/{name}/{side}", part, side, color) for side, color in sides]
        if name in self._draggable:
            for handle in handles:
                handle.on_drag(self._on_drag)
        return handles

    def _add_side(self, path: str, part: Part, side: str, color: Color) -> Any:
        settings = {"color": _rgb(color), "opacity": _opacity(part.look), "flat_shading": part.look.is_flat, "side": side}
        if isinstance(part, Copies):
            settings["batched_colors"] = settings.pop("color")
            pose = {"batched_wxyzs": part.rotations, "batched_positions": part.positions, "lod": "off"}
            return self.server.scene.add_batched_meshes_simple(path, part.vertices, part.faces, **pose, **settings)
        return self.server.scene.add_mesh_simple(path, part.vertices, part.faces, **settings)

    async def _on_drag(self, event: Any) -> None:
        # A coroutine: viser calls others out of order.
        self._drags.put(Drag(event.client_id, event.phase, np.array(event.start_position), np.array(event.end_position)))

    async def _forget_client(self, client: viser.ClientHandle) -> None:
        self._drags.put(Drag(client.client_id, "end", np.zeros(3), np.zeros(3)))


def _rgb(color: Color) -> tuple[int, int, int]:
    red, green, blue = (round(255.0 * value) for value in color)
    return red, green, blue


def _opacity(look: Look) -> float | None:
    return None if look.opacity == 1.0 else look.opacity
