"""Pictures of a world by matplotlib, for machines on which SAPIEN cannot draw."""

from __future__ import annotations

import numpy as np
import torch
from mani_skill.sensors.camera import CameraConfig
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from maniskill_grpd.tasks.drawing import Drawing

TABLE_HALF_SIZE = 0.8
TILE_SIZE = 0.1
"""Distance of the lines on the table [m]."""
BACKGROUND_COLOR = "#f4f4f2"
TABLE_COLOR = "#dcd7cd"
TILE_COLOR = "#cbc5b9"
SHADOW_COLOR = "#6b6459"
ROPE_COLOR = "#cc5a1a"
GRIPPER_COLOR = "#1f3f9e"
GOAL_COLOR = "#3d7bea"
SOLVED_COLOR = "#1fae47"
DPI = 100
POINTS_PER_PIXEL = 72 / DPI
GRIPPER_SIZE = 1.8
"""Radius of the gripper discs in radii of the rope."""
GOAL_THICKNESS = 1.8
"""Radius of the goal in radii of the rope: it can be seen around a rope that lies in it."""


class MatplotlibPainter:
    """Draws one world as lines through a pinhole camera. Table at z = 0.

    The figure is set up once; a picture only redraws what moves, on a saved background.

    Limitation: nothing hides anything; things are drawn in a fixed order, from the table up.
    """

    def __init__(self, camera: CameraConfig) -> None:
        """Set up the figure.

        Args:
            camera: Where the camera stands, its vertical field of view and the size of its images.
        """
        self._camera = _PinholeCamera(camera)
        figure = Figure(figsize=(camera.width / DPI, camera.height / DPI), dpi=DPI)
        self._canvas = FigureCanvasAgg(figure)
        self._axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set(xlim=(0, camera.width), ylim=(camera.height, 0))
        self._axes.set_axis_off()
        figure.set_facecolor(BACKGROUND_COLOR)
        self._draw_table()
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)
        self._shadow = self._add_line(SHADOW_COLOR, 0.35)
        self._goal = self._add_line(GOAL_COLOR, 0.5)
        self._stems = self._add_line(GRIPPER_COLOR, 0.6)
        self._rope = self._add_line(ROPE_COLOR, 1.0)
        self._grippers = self._add_line(GRIPPER_COLOR, 0.9)
        self._grippers.set(linestyle="none", marker="o", markeredgecolor="white")

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Draw a world."""
        width = 2.0 * drawing.object.radius * self._camera.scale_at(drawing.object.points) * POINTS_PER_PIXEL
        self._shadow.set(**self._on_table(drawing.object.points), linewidth=width)
        self._goal.set(
            **self._at(drawing.goal.points), linewidth=GOAL_THICKNESS * width, visible=not hide_goal
        )
        self._goal.set_color(SOLVED_COLOR if drawing.is_solved else GOAL_COLOR)
        self._stems.set(**self._at(_stems(drawing.grippers)), linewidth=0.4 * width)
        self._rope.set(**self._at(drawing.object.points), linewidth=width)
        self._grippers.set(**self._at(drawing.grippers), markersize=GRIPPER_SIZE * width)
        self._canvas.restore_region(self._background)
        for artist in (self._shadow, self._goal, self._stems, self._rope, self._grippers):
            self._axes.draw_artist(artist)

    def picture(self) -> torch.Tensor:
        """Return what was drawn last, (1, H, W, 3) uint8 on the CPU."""
        return torch.from_numpy(np.asarray(self._canvas.buffer_rgba())[None, ..., :3].copy())

    def _draw_table(self) -> None:
        corners = TABLE_HALF_SIZE * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        self._axes.add_patch(Polygon(self._camera.project(corners), color=TABLE_COLOR))
        for at in np.arange(-TABLE_HALF_SIZE, TABLE_HALF_SIZE + TILE_SIZE / 2, TILE_SIZE):
            for ends in ([[at, -TABLE_HALF_SIZE, 0], [at, TABLE_HALF_SIZE, 0]],
                         [[-TABLE_HALF_SIZE, at, 0], [TABLE_HALF_SIZE, at, 0]]):  # fmt: skip
                x, y = self._camera.project(np.array(ends)).T
                self._axes.add_line(Line2D(x, y, color=TILE_COLOR, linewidth=0.7))

    def _add_line(self, color: str, alpha: float) -> Line2D:
        line = Line2D([], [], color=color, alpha=alpha, animated=True)
        line.set(solid_capstyle="round", solid_joinstyle="round")
        self._axes.add_line(line)
        return line

    def _at(self, points: np.ndarray) -> dict[str, np.ndarray]:
        x, y = self._camera.project(points).T
        return {"xdata": x, "ydata": y}

    def _on_table(self, points: np.ndarray) -> dict[str, np.ndarray]:
        return self._at(points * (1.0, 1.0, 0.0))


class _PinholeCamera:
    """Projection of a ManiSkill camera, which looks along its x-axis, z up."""

    def __init__(self, config: CameraConfig) -> None:
        matrix = config.pose.to_transformation_matrix()[0].cpu().numpy()
        self._rotation, self._position = matrix[:3, :3], matrix[:3, 3]
        self._focal = config.height / 2.0 / np.tan(config.fov / 2.0)
        self._centre = np.array([config.width / 2.0, config.height / 2.0])

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (n, 2), x right and y down, of points (n, 3) [m]; NaN behind it."""
        forward, left, up = ((points - self._position) @ self._rotation).T
        forward = np.where(forward > 1e-3, forward, np.nan)
        return self._centre - self._focal * np.stack([left, up], axis=1) / forward[:, None]

    def scale_at(self, points: np.ndarray) -> float:
        """Return pixels per metre at the mean depth of points (n, 3)."""
        depth = ((points - self._position) @ self._rotation)[:, 0].mean()
        return float(self._focal / max(depth, 1e-3))


def _stems(grippers: np.ndarray) -> np.ndarray:
    """Return vertical lines from the table to each gripper as one polyline with gaps, (3 A, 3)."""
    gaps = np.full_like(grippers, np.nan)
    return np.stack([grippers * (1.0, 1.0, 0.0), grippers, gaps], axis=1).reshape(-1, 3)
