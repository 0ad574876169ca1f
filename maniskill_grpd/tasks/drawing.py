"""What there is to see in one world, and who paints it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from mani_skill.sensors.camera import parse_camera_configs, update_camera_configs_from_dict

if TYPE_CHECKING:
    from maniskill_grpd.tasks.deformable_env import DeformableEnv


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Everything visible in one world, in its own frame."""

    rope: np.ndarray
    """Nodes of the rope, (N, 3) [m]."""
    goal: np.ndarray
    """Where its nodes should lie, (N, 3) [m]."""
    grippers: np.ndarray
    """Positions of the grippers, (A, 3) [m]."""
    radius: float
    """Radius of the rope [m]."""
    is_solved: bool
    """Whether the goal is drawn in the colour of success."""


class Painter(Protocol):
    """Shows one world at a time."""

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Set up the scene that is pictured next; observations do not show the goal."""

    def picture(self) -> torch.Tensor:
        """Return an image of what was shown last, (1, H, W, 3) uint8."""


def choose_painter(env: DeformableEnv) -> Painter | None:
    """Return the painter for an environment: SAPIEN where it can draw, else matplotlib, or None."""
    if env.scene.can_render():
        from maniskill_grpd.tasks.sapien_painter import SapienPainter

        return SapienPainter(
            env.scene, env.solver.num_nodes, env.num_grippers, env.solver.model.radius
        )
    if env.render_mode == "rgb_array":
        from maniskill_grpd.tasks.matplotlib_painter import MatplotlibPainter

        configs = parse_camera_configs(env._default_human_render_camera_configs)
        update_camera_configs_from_dict(configs, env._custom_human_render_camera_configs or {})
        return MatplotlibPainter(next(iter(configs.values())))
    return None
