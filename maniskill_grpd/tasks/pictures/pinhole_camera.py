"""The projection of a camera of ManiSkill."""

from __future__ import annotations

import numpy as np
from mani_skill.sensors.camera import CameraConfig

NEAREST_DEPTH = 0.01
"""What is nearer is not seen [m]."""


class PinholeCamera:
    """Looks along the x-axis of its pose, z up; sees the whole picture at its vertical field of view.

    Attributes:
        width, height: Of its pictures [pixels].
        position: (3,) [m].
    """

    def __init__(self, config: CameraConfig, magnification: int = 1) -> None:
        """Take the pose and lens of a camera, with pictures a whole number of times as large."""
        matrix = config.pose.to_transformation_matrix()[0].cpu().numpy().astype(np.float64)
        self._rotation, self.position = matrix[:3, :3], matrix[:3, 3]
        self.width, self.height = magnification * config.width, magnification * config.height
        self._focal = self.height / 2.0 / np.tan(config.fov / 2.0)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project points (..., 3) [m].

        Returns:
            Pixels (..., 2), x right and y down, and nearness (...) [1/m], the inverse depth; NaN behind the camera.
        """
        seen = (points - self.position) @ self._rotation
        depth = np.where(seen[..., 0] > NEAREST_DEPTH, seen[..., 0], np.nan)
        right_down = -self._focal * seen[..., 1:] / depth[..., None]
        return right_down + (self.width / 2.0, self.height / 2.0), 1.0 / depth
