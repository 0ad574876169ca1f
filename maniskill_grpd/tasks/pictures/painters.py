"""Who paints the worlds of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import torch
from mani_skill.sensors.camera import parse_camera_configs, update_camera_configs_from_dict

from maniskill_grpd.tasks.pictures.drawing import Drawing

if TYPE_CHECKING:
    from maniskill_grpd.tasks.pictures.world_pictures import WorldPictures


class Painter(Protocol):
    """Shows one world at a time."""

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Set up the scene that is pictured next; observations do not show the goal."""

    def picture(self) -> torch.Tensor:
        """Return an image of what was shown last, (1, H, W, 3) uint8."""


def choose_painter(env: WorldPictures) -> Painter | None:
    """Return the painter for an environment: SAPIEN where it can draw, else numpy, or None."""
    if env.scene.can_render():
        from maniskill_grpd.tasks.pictures.sapien_painter import SapienPainter

        return SapienPainter(env.scene)
    if env.render_mode == "rgb_array":
        from maniskill_grpd.tasks.pictures.numpy_painter import NumpyPainter

        configs = parse_camera_configs(env._default_human_render_camera_configs)
        update_camera_configs_from_dict(configs, env._custom_human_render_camera_configs or {})
        return NumpyPainter(next(iter(configs.values())))
    return None
