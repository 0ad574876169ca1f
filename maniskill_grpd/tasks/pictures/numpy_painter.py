"""Pictures of a world drawn in numpy, for machines on which SAPIEN cannot draw."""

from __future__ import annotations

import numpy as np
import torch
from mani_skill.sensors.camera import CameraConfig
from scipy.ndimage import uniform_filter

from maniskill_grpd.rendering import palette
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet, Tube
from maniskill_grpd.tasks.pictures.pinhole_camera import PinholeCamera
from maniskill_grpd.tasks.pictures.rasterizer import Canvas, scan
from maniskill_grpd.tasks.pictures.surfaces import (
    Surface,
    ghost_surface,
    gripper_surfaces,
    mark_surface,
    shadow_surface,
    surface_of,
    table_lines,
    table_top,
)

SAMPLES = 2
"""Samples per pixel and direction: edges get soft."""
SHADOW_BLUR = 5
"""Width of the soft edge of shadows [pixels]."""
AMBIENT, DIRECT, FILL, GLOSS = 0.44, 0.46, 0.18, 0.16
"""Shares of the light from everywhere, from the lamp and from the camera; strength of the lamp's reflections."""
GLOSS_EXPONENT = 24.0
GHOST_ALPHA = 0.38
MARK_ALPHA, HIDDEN_MARK_ALPHA = 0.9, 0.35
GHOST_LEADS = {Tube: 0.02, Sheet: 0.003}
"""Distance by which a ghost must be nearer than something on the table to cover it [m]."""
EDGE_STEP = 0.0022
"""Steps of the nearness [1/m] that are drawn as edges: 4 mm at a distance of 1.3 m."""
EDGE_DARKNESS = 0.35


class NumpyPainter:
    """Draws one world as shaded triangles through a pinhole camera. Table at z = 0.

    Shadows fall on the table alone. The goal is a ghost that tints what it covers; outlines and lines can be seen through
    everything, fainter.
    """

    def __init__(self, camera: CameraConfig) -> None:
        """Draw what never moves, once.

        Args:
            camera: Where the camera stands, its vertical field of view and the size of its images.
        """
        self._camera = PinholeCamera(camera, SAMPLES)
        self._view = self._towards_camera(np.zeros(3))
        half = palette.LIGHT_DIRECTION + self._view
        self._glossy_normal = half / np.linalg.norm(half)
        self._empty, self._with_table = self._backdrop(), self._table()
        self._ground, self._canvas = self._empty, self._empty.copy()
        self._ground_picture = self._to_pixels(self._ground.colors)
        self._low, self._high = self._nowhere()

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Draw a world."""
        self._wipe(self._with_table if drawing.has_table else self._empty)
        parts = [(surface_of(solid), solid.color, solid.color) for solid in drawing.solids]
        back = palette.BACK if isinstance(drawing.object, Sheet) else palette.FRONT
        parts.append((surface_of(drawing.object), palette.FRONT, back))
        for surface, is_closed in zip(gripper_surfaces(drawing), drawing.closed, strict=True):
            color = palette.CLOSED_GRIPPER if is_closed else palette.OPEN_GRIPPER
            parts.append((surface, color, color))
        if drawing.has_table:
            self._cast_shadows([surface for surface, *_ in parts])
        for part in parts:
            triangles = self._shaded(*part)
            self._touch(triangles[0])
            self._canvas.paint(*triangles)
        self._draw_edges()
        if not hide_goal:
            self._draw_goal(drawing)

    def picture(self) -> torch.Tensor:
        """Return what was drawn last, (1, H, W, 3) uint8 on the CPU."""
        picture = self._ground_picture.copy()
        rows, columns = self._touched()
        low, high = (slice(part.start // SAMPLES, part.stop // SAMPLES) for part in (rows, columns))
        picture[low, high] = self._to_pixels(self._canvas.colors[rows, columns])
        return torch.from_numpy(picture[None])

    def _wipe(self, ground: Canvas) -> None:
        """Take a picture of what never moves as the canvas; what is on it already is replaced only where it was drawn upon."""
        if ground is not self._ground:
            self._ground, self._canvas = ground, ground.copy()
            self._ground_picture = self._to_pixels(ground.colors)
        window = self._touched()
        self._canvas.colors[window] = ground.colors[window]
        self._canvas.nearness[window] = ground.nearness[window]
        self._low, self._high = self._nowhere()

    def _nowhere(self) -> tuple[np.ndarray, np.ndarray]:
        return np.full(2, 1e9), np.full(2, -1e9)

    def _touch(self, pixels: np.ndarray, margin: int = 0) -> None:
        """Note that something is drawn within `margin` of pixels (..., 2); NaN is behind the camera."""
        seen = pixels[np.isfinite(pixels).all(axis=-1)]
        if len(seen):
            self._low = np.minimum(self._low, seen.min(axis=0) - margin)
            self._high = np.maximum(self._high, seen.max(axis=0) + margin)

    def _touched(self) -> tuple[slice, slice]:
        """Return the rows and columns on which something is drawn, in whole pixels of the picture."""
        size = (self._camera.width, self._camera.height)
        low, high = (
            SAMPLES * np.clip(bound // SAMPLES + past, 0, np.array(size) // SAMPLES).astype(np.int64)
            for bound, past in ((self._low - 1.0, 0), (self._high + 1.0, 1))
        )
        (left, top), (right, bottom) = low, np.maximum(low, high)
        return slice(top, bottom), slice(left, right)

    @staticmethod
    def _to_pixels(colors: np.ndarray) -> np.ndarray:
        """Average the samples of each pixel, (H, W, 3) float32 to (H / SAMPLES, W / SAMPLES, 3) uint8."""
        steps = range(SAMPLES)
        light = sum(colors[row::SAMPLES, column::SAMPLES] for row in steps for column in steps)
        return (light * (255.0 / SAMPLES**2) + 0.5).clip(0.0, 255.0).astype(np.uint8)

    def _draw_goal(self, drawing: Drawing) -> None:
        color = palette.SOLVED if drawing.is_solved else palette.GOAL
        ghost = ghost_surface(drawing)
        if ghost is not None:
            triangles = self._shaded(ghost, color, color)
            self._touch(triangles[0])
            self._canvas.glaze(*triangles, alpha=GHOST_ALPHA, limit=self._ghost_limit(GHOST_LEADS[type(drawing.goal)]))
        marks = self._shaded(mark_surface(drawing), color, color)
        self._touch(marks[0])
        self._canvas.glaze(*marks, alpha=MARK_ALPHA, hidden_alpha=HIDDEN_MARK_ALPHA)

    def _ghost_limit(self, lead: float) -> np.ndarray:
        """Return up to which nearness a ghost is covered, (H, W), where something is drawn.

        What lies in its goal is not covered: it would take on the colour of the ghost.
        """
        limit, window = self._canvas.nearness.copy(), self._touched()
        near = limit[window]
        leads = np.where(near == self._with_table.nearness[window], 0.0, lead)
        limit[window] = near / (1.0 - leads * near)
        return limit

    def _backdrop(self) -> Canvas:
        shape = (self._camera.height, self._camera.width)
        colors = np.broadcast_to(np.float32(palette.BACKGROUND), (*shape, 3))
        return Canvas(colors.copy(), np.zeros(shape, dtype=np.float32))

    def _table(self) -> Canvas:
        canvas = self._backdrop()
        for surface, color in ((table_top(), palette.TABLE), (table_lines(), palette.TABLE_LINES)):
            pixels, nearness, _ = self._shaded(surface, color, color)
            canvas.paint(pixels, nearness, np.broadcast_to(color, (len(pixels), 3, 3)))
        return canvas

    def _cast_shadows(self, surfaces: list[Surface]) -> None:
        """Darken the table where light does not get past some surfaces."""
        shadow = np.zeros(self._canvas.nearness.shape, dtype=np.float32)
        for surface in surfaces:
            shade = shadow_surface(surface)
            pixels = self._camera.project(shade.vertices[shade.faces])[0]
            self._touch(pixels, margin=SHADOW_BLUR * SAMPLES)
            fragments = scan(pixels, shadow.shape)
            shadow[fragments.rows, fragments.columns] = 1.0
        window = self._touched()
        shadow = uniform_filter(shadow[window], SHADOW_BLUR * SAMPLES)
        self._canvas.colors[window] *= (1.0 - palette.SHADOW_DARKNESS * shadow)[..., None]

    def _draw_edges(self) -> None:
        """Darken what lies just behind the edge of something nearer."""
        window = self._touched()
        near = self._canvas.nearness[window]
        # The nearness of a plane is linear over the picture: this sees steps, and nothing else.
        step = np.zeros_like(near)
        step[1:-1, 1:-1] = near[:-2, 1:-1] + near[2:, 1:-1] + near[1:-1, :-2] + near[1:-1, 2:] - 4.0 * near[1:-1, 1:-1]
        at = np.nonzero(step > EDGE_STEP)
        strength = EDGE_DARKNESS * np.clip(step[at] / EDGE_STEP - 1.0, 0.0, 1.0)
        self._canvas.colors[window][at] *= (1.0 - strength)[:, None]

    def _shaded(self, surface: Surface, front: palette.Color, back: palette.Color) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the triangles of a surface as a canvas takes them, each in the colour of the side that is seen."""
        corners = surface.vertices[surface.faces]
        outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        is_front = (outward * self._towards_camera(corners[:, 0])).sum(axis=-1) > 0.0
        normals = np.where(is_front[:, None, None], 1.0, -1.0) * surface.normals[surface.faces]
        base = np.where(is_front[:, None, None], np.array(front), np.array(back))
        pixels, nearness = self._camera.project(corners)
        return pixels, nearness, base * self._brightness(normals) + self._reflection(normals)

    def _brightness(self, normals: np.ndarray) -> np.ndarray:
        """Return the light that surfaces with normals (..., 3) scatter, (..., 1); about 1 for those that face the lamp."""
        lamp, camera = (np.maximum(normals @ direction, 0.0) for direction in (palette.LIGHT_DIRECTION, self._view))
        return (AMBIENT + DIRECT * lamp + FILL * camera)[..., None]

    def _reflection(self, normals: np.ndarray) -> np.ndarray:
        """Return the lamp's light that is reflected into the camera, as if it looked at the origin, (..., 1)."""
        return GLOSS * (np.maximum(normals @ self._glossy_normal, 0.0) ** GLOSS_EXPONENT)[..., None]

    def _towards_camera(self, points: np.ndarray) -> np.ndarray:
        directions = self._camera.position - points
        return directions / np.linalg.norm(directions, axis=-1, keepdims=True)
