"""Who paints the worlds of an environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mani_skill.sensors.camera import parse_camera_configs, update_camera_configs_from_dict

from maniskill_grpd.tasks.pictures.painter import Painter

if TYPE_CHECKING:
    from maniskill_grpd.tasks.pictures.world_pictures import WorldPictures


def choose_painter(env: WorldPictures) -> Painter | None:
    """Return the painter for an environment: SAPIEN where it can draw, else the canvas in Warp, or None."""
    if env.scene.can_render():
        from maniskill_grpd.tasks.pictures.sapien_painter import SapienPainter

        return SapienPainter(env.scene)
    if env.render_mode in ("rgb_array", "all"):
        from maniskill_grpd.tasks.pictures.warp_painter import WarpPainter

        configs = parse_camera_configs(env._default_human_render_camera_configs)
        update_camera_configs_from_dict(configs, env._custom_human_render_camera_configs or {})
        return WarpPainter(next(iter(configs.values())))
    return None
