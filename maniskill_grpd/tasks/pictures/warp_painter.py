"""Pictures of a world without a graphics driver."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar

import numpy as np
import torch
from mani_skill.sensors.camera import CameraConfig

from maniskill_grpd.rendering import Lens, palette
from maniskill_grpd.rendering.bodies import TABLE_HALF_SIZE
from maniskill_grpd.rendering.canvas import Canvas, ShadedMesh, ShadedTriangles
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet, Solid, Tube
from maniskill_grpd.tasks.pictures.surfaces import (
    SHADOW_HEIGHT,
    Surface,
    ghost_surface,
    gripper_surfaces,
    mark_surface,
    surface_of,
    table_lines,
    table_top,
)

GHOST_ALPHA = 0.38
MARK_ALPHA, HIDDEN_MARK_ALPHA = 0.9, 0.35
GHOST_LEADS = {Tube: 0.02, Sheet: 0.003}
"""Distance by which a ghost must be nearer than something on the table to cover it [m]: what lies in its goal is not covered."""
MOST_KEPT = 64
"""How many goals, marks and obstacles are kept, which mostly look the same in the next picture."""

T = TypeVar("T")
Painted = tuple[Surface, palette.Color, palette.Color]
"""A surface, and the colours of its front and back."""


class WarpPainter:
    """Draws one world as shaded triangles through a pinhole camera. Table at z = 0.

    Shadows fall on the table alone. The goal is a ghost that tints what it covers; outlines and lines can be seen through
    everything, fainter.
    """

    def __init__(self, camera: CameraConfig) -> None:
        """Set up the canvas.

        Args:
            camera: Where the camera stands, its vertical field of view and the size of its images.
        """
        pose = camera.pose.to_transformation_matrix()[0].cpu().numpy().astype(np.float64)
        self._canvas = Canvas(Lens(camera.width, camera.height, camera.near, camera.far), camera.fov, pose)
        self._has_table: bool | None = None
        self._kept: OrderedDict[Hashable, Any] = OrderedDict()

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Draw a world."""
        self._lay_table(drawing.has_table)
        opaque = _joined(self._opaque_parts(drawing))
        if drawing.has_table:
            self._canvas.cast_shadows(opaque, half_size=TABLE_HALF_SIZE, height=SHADOW_HEIGHT)
        self._canvas.paint(self._canvas.shade(opaque))
        self._canvas.draw_edges()
        if not hide_goal:
            self._draw_goal(drawing)

    def picture(self) -> torch.Tensor:
        """Return what was drawn last, (1, H, W, 3) uint8 on the CPU."""
        return torch.from_numpy(self._canvas.picture()[None])

    def _lay_table(self, has_table: bool) -> None:
        if has_table == self._has_table:
            self._canvas.wipe()
            return
        table = [(table_top(), palette.TABLE, palette.TABLE), (table_lines(), palette.TABLE_LINES, palette.TABLE_LINES)]
        self._canvas.set_ground(palette.BACKGROUND, [_joined([part]) for part in table] if has_table else [])
        self._has_table = has_table

    def _opaque_parts(self, drawing: Drawing) -> list[Painted]:
        back = palette.BACK if isinstance(drawing.object, Sheet) else palette.FRONT
        parts = [(surface_of(drawing.object), palette.FRONT, back)]
        parts += [(self._solid(solid), solid.color, solid.color) for solid in drawing.solids]
        for surface, is_closed in zip(gripper_surfaces(drawing), drawing.closed, strict=True):
            color = palette.CLOSED_GRIPPER if is_closed else palette.OPEN_GRIPPER
            parts.append((surface, color, color))
        return parts

    def _draw_goal(self, drawing: Drawing) -> None:
        goal = () if drawing.goal is None else _content(drawing.goal)
        ghost = self._keep(("ghost", drawing.is_solved, *goal), lambda: self._shaded(ghost_surface(drawing), drawing))
        if ghost is not None:
            self._canvas.glaze(ghost, alpha=GHOST_ALPHA, lead=GHOST_LEADS[type(drawing.goal)])
        lines = tuple(line.points.tobytes() for line in drawing.lines)
        key = ("marks", drawing.is_solved, *goal, *lines)
        marks = self._keep(key, lambda: self._shaded(mark_surface(drawing), drawing))
        if marks is not None:
            self._canvas.glaze(marks, alpha=MARK_ALPHA, hidden_alpha=HIDDEN_MARK_ALPHA)

    def _shaded(self, surface: Surface | None, drawing: Drawing) -> ShadedTriangles | None:
        """Return a part of a goal as the camera sees it; None where there is none."""
        if surface is None or not len(surface.faces):
            return None
        color = palette.SOLVED if drawing.is_solved else palette.GOAL
        return self._canvas.shade(_joined([(surface, color, color)]))

    def _solid(self, solid: Solid) -> Surface:
        return self._keep(("solid", *_content(solid)), lambda: surface_of(solid))

    def _keep(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what was made before from the same content, or make it."""
        if key not in self._kept:
            self._kept[key] = make()
        self._kept.move_to_end(key)
        if len(self._kept) > MOST_KEPT:
            self._kept.popitem(last=False)
        return self._kept[key]


def _content(body: Tube | Sheet | Solid) -> tuple[Hashable, ...]:
    if isinstance(body, Tube):
        return body.points.tobytes(), body.radius
    return body.vertices.tobytes(), body.faces.tobytes()


def _joined(parts: Sequence[Painted]) -> ShadedMesh:
    """Return surfaces in their colours as one mesh."""
    surfaces = [surface for surface, *_ in parts]
    starts = np.cumsum([0] + [len(surface.vertices) for surface in surfaces[:-1]])
    counts = [len(surface.faces) for surface in surfaces]
    fronts, backs = (np.repeat(np.array(colors), counts, axis=0) for colors in zip(*(part[1:] for part in parts), strict=True))
    return ShadedMesh(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate([surface.normals for surface in surfaces]),
        np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=True)]),
        fronts,
        backs,
    )
