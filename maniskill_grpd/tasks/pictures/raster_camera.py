"""Cameras of ManiSkill whose images the rasteriser draws, of all worlds at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

import torch
from mani_skill.sensors.base_sensor import BaseSensor
from mani_skill.sensors.camera import Camera, CameraConfig, parse_camera_configs, update_camera_configs_from_dict
from mani_skill.utils.geometry.rotation_conversions import matrix_to_quaternion
from mani_skill.utils.structs.pose import Pose

from maniskill_grpd.agents.arms import ArmArticulation
from maniskill_grpd.agents.arms.link_frames import link_frames
from maniskill_grpd.rendering import DepthSensor, Label, Lens, Rasterizer, SolverScene, extrinsic_from_pose, intrinsic_from_fov
from maniskill_grpd.rendering.inside import is_inside

MILLIMETRES = 1000.0
"""ManiSkill's unit of depths and positions."""


class RasterCamera(Camera):
    """A sensor of ManiSkill without SAPIEN.

    Images have ManiSkill's names, shapes and units: `rgb` and `albedo` (B, H, W, 3) uint8, `depth` (B, H, W, 1) int16 [mm],
    `segmentation` (B, H, W, 1) int16, see `Label`, `position` (B, H, W, 3) int16 [mm] and `normal` (B, H, W, 3) float32 in the
    frame of OpenGL (x right, y up, z backward). Where nothing is seen depth, position, segmentation and normal are 0.
    """

    def __init__(
        self,
        config: CameraConfig,
        view: SolverScene,
        carriers: Mapping[str, Any],
        sensor: DepthSensor | None = None,
        seeds: Callable[[], torch.Tensor] | None = None,
    ) -> None:
        """Set up a camera.

        Args:
            config: Pose, lens and size; `mount` is anything with a `pose`.
            view: What the camera sees.
            carriers: What `entity_uid` may name.
            sensor: Errors of its depths and positions; none by default.
            seeds: Returns a seed of those errors for each world, (B,) int32.

        Raises:
            ValueError: If the lens is impossible, or what carries the camera has no pose.
        """
        BaseSensor.__init__(self, config)  # that of Camera asks SAPIEN for a camera
        self._view, self._device = view, view.scene.device
        self._sensor, self._seeds = sensor, seeds
        self.entity = config.mount if config.entity_uid is None else carriers.get(config.entity_uid)
        if (config.entity_uid, config.mount) != (None, None) and not hasattr(self.entity, "pose"):
            moving = [name for name, carrier in carriers.items() if hasattr(carrier, "pose")]
            raise ValueError(f"camera {config.uid!r} can be mounted on {moving or 'nothing here'}, got {config.entity_uid!r}")
        lens = Lens(config.width, config.height, config.near, config.far)
        self._rasterizer = Rasterizer(view.scene, lens, self._intrinsics()[None], self._extrinsics()[:, None])

    def capture(self) -> None:
        """Draw what the camera sees; `SolverScene.update` comes first."""
        self._follow()
        self._rasterizer.draw()

    def check_place(self, worlds: torch.Tensor) -> None:
        """Refuse a camera that is inside an obstacle, a gripper or the rope in some worlds (b,), where it would see nothing else.

        Raises:
            ValueError: With the worlds.
        """
        self._view.update()
        extrinsics = self._extrinsics()[worlds]
        places = -(extrinsics[:, :, :3].mT @ extrinsics[:, :, 3:])[..., 0]
        inside = is_inside(self._view.scene, worlds, places, (Label.OBSTACLE, Label.GRIPPER, Label.ROPE))
        if bool(inside.any()):
            raise ValueError(
                f"camera {self.config.uid!r} is inside an obstacle, a gripper or the rope in worlds {worlds[inside].tolist()}; "
                "move it with sensor_configs"
            )

    def visible(self, points: torch.Tensor, tolerance: float) -> torch.Tensor:
        """Tell which points (B, P, 3) [m] the camera sees now, (B, P); `SolverScene.update` comes first.

        See `Rasterizer.visible`.
        """
        self._follow()
        self._rasterizer.look()
        return self._rasterizer.visible(points, tolerance)[:, 0]

    def _follow(self) -> None:
        if self.entity is not None:
            self._rasterizer.extrinsics.copy_(self._extrinsics()[:, None])

    def get_obs(
        self,
        rgb: bool = True,
        depth: bool = True,
        position: bool = True,
        segmentation: bool = True,
        normal: bool = False,
        albedo: bool = False,
        apply_texture_transforms: bool = True,
    ) -> dict[str, torch.Tensor]:
        """Return the images wanted of what was drawn last.

        Without `apply_texture_transforms` they are packed as by ManiSkill's shader "minimal": `Color` (B, H, W, 4) uint8 and
        `PositionSegmentation` (B, H, W, 4) int16.
        """
        if not apply_texture_transforms:
            return self._packed()
        images = {}
        if rgb:
            images["rgb"] = self._rasterizer.colors()[:, 0]
        if depth:
            images["depth"] = _rounded(self._depths()[1][..., None])
        if position:
            images["position"] = _rounded(self.positions())
        if segmentation:
            images["segmentation"] = self._rasterizer.segmentation()[:, 0, ..., None]
        if normal:
            images["normal"] = _to_opengl(self._rasterizer.normals()[:, 0])
        if albedo:
            images["albedo"] = self._rasterizer.colors(is_lit=False)[:, 0]
        return images

    def positions(self) -> torch.Tensor:
        """Return where what was drawn last lies in the frame of OpenGL, not rounded, (B, H, W, 3) [m]; 0 for nothing."""
        positions = _to_opengl(self._rasterizer.positions()[:, 0])
        if self._sensor is None:
            return positions
        exact, measured = self._depths()
        return positions * torch.where(exact > 0.0, measured / exact, 0.0)[..., None]

    def get_params(self) -> dict[str, torch.Tensor]:
        """Return `extrinsic_cv` (B, 3, 4), `cam2world_gl` (B, 4, 4) and `intrinsic_cv` (B, 3, 3)."""
        extrinsic = self._extrinsics()
        turn = extrinsic[:, :, :3].transpose(1, 2)
        inverse = torch.cat([_to_opengl(turn), -turn @ extrinsic[:, :, 3:]], dim=2)
        last = torch.tensor([0.0, 0.0, 0.0, 1.0], device=self._device).expand(len(extrinsic), 1, 4)
        intrinsic = self._intrinsics().to(self._device).repeat(len(extrinsic), 1, 1)
        return {"extrinsic_cv": extrinsic, "cam2world_gl": torch.cat([inverse, last], dim=1), "intrinsic_cv": intrinsic}

    def _depths(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the exact depths and those that the sensor measures, (B, H, W) [m]; 0 for nothing."""
        exact = self._rasterizer.depth()[:, 0]
        exact = torch.where(torch.isfinite(exact), exact, 0.0)
        return exact, exact if self._sensor is None else self._sensor.measure(exact, self._seeds())

    def _packed(self) -> dict[str, torch.Tensor]:
        colors, labels = self._rasterizer.colors()[:, 0], self._rasterizer.segmentation()[:, 0, ..., None]
        opaque = torch.full_like(colors[..., :1], 255)
        return {
            "Color": torch.cat([colors, opaque], dim=-1),
            "PositionSegmentation": torch.cat([_rounded(self.positions()), labels], dim=-1),
        }

    def _intrinsics(self) -> torch.Tensor:
        config = self.config
        if config.intrinsic is None:
            return intrinsic_from_fov(config.fov, config.width, config.height)
        return torch.as_tensor(config.intrinsic, dtype=torch.float32).reshape(3, 3).cpu()

    def _extrinsics(self) -> torch.Tensor:
        """Return the extrinsics in each world now, (B, 3, 4)."""
        pose = Pose.create(self.config.pose, device=self._device)
        if self.entity is not None:
            pose = self.entity.pose * pose
        matrices = pose.to_transformation_matrix().to(self._device)
        num = self._view.scene.num_worlds
        if len(matrices) not in (1, num):
            raise ValueError(f"camera {self.config.uid!r} must have 1 pose or {num}, one for each world, got {len(matrices)}")
        return extrinsic_from_pose(matrices).expand(num, 3, 4).contiguous()


class LinkMount:
    """What carries a camera with a link of an arm; `entity_uid` calls it "arm_0/panda_hand", by the arm and the link."""

    def __init__(self, arm: ArmArticulation, link: str) -> None:
        """Follow a link of an arm."""
        self._arm, self._link = arm, link

    @property
    def pose(self) -> Pose:
        """Where the link is in each world."""
        frame = link_frames(self._arm)[self._link]
        return Pose.create_from_pq(p=frame[:, :3, 3], q=matrix_to_quaternion(frame[:, :3, :3]))


class GripperMount:
    """What carries a camera with a gripper, which does not turn; `entity_uid` calls it "gripper_0", "gripper_1", ..."""

    def __init__(self, positions: torch.Tensor, index: int) -> None:
        """Follow one of the grippers at positions (B, A, 3) [m]."""
        self._positions, self._index = positions, index

    @property
    def pose(self) -> Pose:
        """Where the gripper is in each world."""
        return Pose.create_from_pq(p=self._positions[:, self._index], device=self._positions.device)


def camera_configs(defaults: Any, changes: Mapping[str, Any] | None, what: str) -> dict[str, CameraConfig]:
    """Return the cameras of a task by name, with the changes of a user: for all cameras by field, for one by its name.

    Raises:
        ValueError: If a change names neither a camera nor a field; says which there are.
    """
    configs = parse_camera_configs(defaults)
    known = {field.name for field in fields(CameraConfig)}
    unknown = [name for name in changes or {} if name not in known | set(configs)]
    unknown += [name for camera in set(configs) & set(changes or {}) for name in changes[camera] if name not in known]
    if unknown:
        raise ValueError(f"{what} has {unknown}; allowed are the cameras {sorted(configs)} and the settings {sorted(known)}")
    update_camera_configs_from_dict(configs, {**changes} if changes else {})
    return configs


def _to_opengl(vectors: torch.Tensor) -> torch.Tensor:
    """Return vectors (..., 3) of a camera of OpenCV as one of OpenGL has them, or the other way round."""
    return vectors * vectors.new_tensor([1.0, -1.0, -1.0])


def _rounded(lengths: torch.Tensor) -> torch.Tensor:
    """Return lengths [m] in whole millimetres, int16."""
    return (lengths * MILLIMETRES).round().to(torch.int16)
