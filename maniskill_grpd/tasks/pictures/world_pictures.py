"""Pictures of the worlds of a batch, one world after the other on a single stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any

import numpy as np
import torch
import trimesh
from mani_skill.sensors.camera import CameraConfig, parse_camera_configs
from mani_skill.utils import sapien_utils
from mani_skill.utils.visualization.misc import tile_images

from maniskill_grpd.agents.arms.link_frames import link_frames
from maniskill_grpd.physics import Model, Solver
from maniskill_grpd.rendering import DepthSensor, SolverScene, palette
from maniskill_grpd.tasks.options.observation_mode import needs_camera
from maniskill_grpd.tasks.pictures.arm_solids import arm_bodies, arm_solids
from maniskill_grpd.tasks.pictures.browser_window import BrowserWindow
from maniskill_grpd.tasks.pictures.collider_solids import collider_solids
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet, Solid, Tube
from maniskill_grpd.tasks.pictures.painter import Painter
from maniskill_grpd.tasks.pictures.painters import choose_painter
from maniskill_grpd.tasks.pictures.raster_camera import MILLIMETRES, GripperMount, LinkMount, RasterCamera, camera_configs
from maniskill_grpd.tasks.worlds.batched_scene import BatchedScene
from maniskill_grpd.tasks.worlds.embodied_worlds import EmbodiedWorlds
from maniskill_grpd.tasks.worlds.measured_worlds import MeasuredWorlds

FRAME_WIDTH = 0.015
"""Width of the frames of solved worlds in heights of a picture."""
AMBIENT_LIGHT, DIRECT_LIGHT, FILL_LIGHT = 0.30, 1.7, 0.6
"""Strengths of SAPIEN's lights: from everywhere, from the lamp, from the camera."""
PICTURE_SIZE = 512
"""Height and width of the pictures of `render()` [pixels]."""
LARGE_PICTURES = 4
"""Largest number of worlds that are drawn in that size; more are tiles of a video and half as large."""
MOST_CAMERAS = 8
MAX_DRAWN_WORLDS = 16
"""`render()` draws one image per world for at most this many worlds."""


class WorldPictures(EmbodiedWorlds, MeasuredWorlds):
    """The part of an environment that takes pictures.

    Without SAPIEN Warp draws: what the cameras of all worlds see at once, and what `render_mode="rgb_array"` returns.
    SAPIEN has one stage for all worlds: each is mirrored on it in turn.

    Args:
        depth_sensor: Errors of the depths that cameras measure, settings of `DepthSensor` by name; none by default.
        num_cameras: Cameras of observations, 1 (default) to 8, evenly round the vertical through what they look at:
            "base_camera", "base_camera_1" and so on.
        settings: Those of the classes below.

    Raises:
        ValueError: If there is no such setting, their number is not allowed, or SAPIEN draws, whose depths are exact.
    """

    CAMERA_POSITION = (0.0, -0.7, 1.15)
    """Where the cameras stand [m]; by default above the near edge of the table, to see all of it that matters."""
    CAMERA_TARGET = (0.0, -0.05, 0.0)
    """Where they look [m]."""
    CAMERA_FOV = 0.95
    """Their vertical field of view [rad]."""
    ARM_CAMERA = ((1.55, -1.05, 1.25), (0.0, 0.0, 0.15), 0.85)
    """The same where arms stand round the table, which hide it from nearer."""

    HAS_TABLE = True
    """Whether there is a table, at z = 0."""

    scene: BatchedScene
    solver: Solver
    models: tuple[Model, ...]
    """The variants of the object, among which each episode draws one."""
    _painter: Painter | None
    _raster_view: SolverScene | None
    """What the cameras of the rasteriser see, where it draws observations."""
    _drawn_worlds: range
    """Worlds whose images cameras take: all for observations, one at a time for `render()`."""

    def __init__(self, *, depth_sensor: Mapping[str, float] | None = None, num_cameras: int = 1, **settings: Any) -> None:
        if isinstance(num_cameras, bool) or num_cameras not in range(1, MOST_CAMERAS + 1):
            raise ValueError(f"num_cameras must be a whole number in 1 ... {MOST_CAMERAS}, got {num_cameras!r}")
        self._num_cameras = num_cameras
        self._depth_sensor = DepthSensor.from_mapping(depth_sensor)
        if self._depth_sensor is not None and self._render_device_name is not None:
            raise ValueError('depth_sensor needs the rasteriser: choose render_backend="warp"; depths of SAPIEN are exact')
        super().__init__(**settings)

    def drawing(self, world: int) -> Drawing:
        """Return what there is to see in a world: the object, the obstacles and the grippers.

        A task adds goals and marks: `replace(super().drawing(world), goal=..., lines=...)`.
        """
        solver, model = self.solver, self.model_of(world)
        points = self.nodes_of(world, solver.positions)
        return Drawing(
            object=Tube(points, model.radius) if model.is_rope else Sheet(points, model.faces),
            solids=collider_solids(solver, world) + self._arm_solids(world),
            grippers=solver.gripper_positions[world].cpu().numpy(),
            closed=solver.closed[world].cpu().numpy(),
            is_solved=bool(self.measurement.success[world]),
            has_table=self.HAS_TABLE,
        )

    def _arm_solids(self, world: int) -> tuple[Solid, ...]:
        if self.scene.arms is None:
            return ()
        return tuple(solid for agent in self._agents for solid in arm_solids(agent.robot, world))

    def checked_drawing(self, world: int) -> Drawing:
        """Return `drawing`, and refuse what is none."""
        drawing = self.drawing(world)
        if not isinstance(drawing, Drawing):
            raise TypeError(f"{type(self).__name__}.drawing() must return a Drawing, got {type(drawing).__name__}")
        return drawing

    def model_of(self, world: int) -> Model:
        """Return the variant that a world holds."""
        return self.models[int(self.solver.variants[world])]

    def nodes_of(self, world: int, values: torch.Tensor) -> np.ndarray:
        """Return what a world's nodes have of values (B, N, ...), without the padding, (n, ...)."""
        return values[world, : self.model_of(world).num_nodes].cpu().numpy()

    @property
    def viewpoint(self) -> tuple[Sequence[float], Sequence[float], float]:
        """Where cameras stand and look by default [m], and their vertical field of view [rad]."""
        own = (self.CAMERA_POSITION, self.CAMERA_TARGET, self.CAMERA_FOV)
        return own if self._bases is None else self.ARM_CAMERA

    @property
    def _default_sensor_configs(self) -> list[CameraConfig]:
        turns = 2.0 * np.pi * np.arange(self._num_cameras) / self._num_cameras
        names = ["base_camera", *(f"base_camera_{index}" for index in range(1, self._num_cameras))]
        return [self._camera(name, 128, "minimal", turn) for name, turn in zip(names, turns, strict=True)]

    @property
    def _default_human_render_camera_configs(self) -> CameraConfig:
        size = PICTURE_SIZE if self.num_envs <= LARGE_PICTURES else PICTURE_SIZE // 2
        return self._camera("render_camera", size, "default")

    def _camera(self, uid: str, size: int, shader_pack: str, turn: float = 0.0) -> CameraConfig:
        eye, target, fov = self.viewpoint
        if turn:
            eye = target + trimesh.transformations.rotation_matrix(turn, [0.0, 0.0, 1.0])[:3, :3] @ np.subtract(eye, target)
        pose = sapien_utils.look_at(eye=list(eye), target=list(target))
        return CameraConfig(uid, pose=pose, width=size, height=size, fov=fov, near=0.01, far=10.0, shader_pack=shader_pack)

    def _load_lighting(self, options: dict) -> None:
        self.scene.set_ambient_light([AMBIENT_LIGHT] * 3)
        self.scene.add_directional_light(-palette.LIGHT_DIRECTION, [DIRECT_LIGHT] * 3)
        view = np.subtract(self.CAMERA_TARGET, self.CAMERA_POSITION)
        self.scene.add_directional_light(view, [FILL_LIGHT] * 3)

    def render_rgb_array(self, camera_name: str | None = None) -> torch.Tensor:
        """Return one image per world, (min(B, 16), H, W, 3) uint8; those of solved worlds have a green frame.

        They are 512 pixels high and wide for up to 4 worlds, else 256; `human_render_camera_configs` says otherwise.
        """
        take_picture = partial(super().render_rgb_array, camera_name) if self.scene.can_render() else self._painter.picture
        return self._picture_worlds(take_picture, has_frames=True)

    def render_sensors(self) -> torch.Tensor:
        """Return what the cameras of each world see, side by side."""
        if self._raster_view is None:
            return self._picture_worlds(super().render_sensors)
        return tile_images(self._sensor_pictures())

    def render_all(self) -> torch.Tensor:
        """Return `render_rgb_array` and `render_sensors` side by side."""
        if self._raster_view is None:
            return self._picture_worlds(super().render_all)
        return tile_images([self.render_rgb_array().to(self.device), *self._sensor_pictures()])

    def _sensor_pictures(self) -> list[torch.Tensor]:
        """Return all images of all cameras as pictures, of at most as many worlds as are drawn."""
        cameras = self.get_sensor_images().values()
        return [image[:MAX_DRAWN_WORLDS] for images in cameras for image in images.values()]

    def render_human(self) -> Any:
        """Show the first world in SAPIEN's viewer or, where SAPIEN cannot draw, up to 16 worlds on a page for a browser.

        Returns:
            The viewer; a `BrowserWindow`, where `address` says where the page is, needs viser (the extra `viewer`).
        """
        self.evaluate()
        if not self.scene.can_render():
            if self._viewer is None:
                self._viewer = BrowserWindow(self)
            self._viewer.show()
            return self._viewer
        self._painter.show(self.checked_drawing(0))
        return super().render_human()

    def _setup_viewer(self) -> None:
        if self.scene.can_render():
            super()._setup_viewer()

    def get_sensor_params(self) -> dict[str, dict[str, torch.Tensor]]:
        """Return the cameras' parameters, (B, ...)."""
        if self._raster_view is not None:
            return super().get_sensor_params()
        num = len(self._drawn_worlds)
        return {
            camera: {name: value.repeat(num, *[1] * (value.ndim - 1)) for name, value in params.items()}
            for camera, params in super().get_sensor_params().items()
        }

    def _set_up_drawing(self, options: dict) -> None:
        """Choose who paints, and set up the cameras of the rasteriser; ManiSkill sets up those of SAPIEN."""
        self._painter, self._raster_view = choose_painter(self), None
        if self.render_mode == "human" and not self.scene.can_render():
            self._viewer = BrowserWindow(self)  # ManiSkill opens SAPIEN's where there is none
        has_sensors = needs_camera(self._obs_mode) or self.render_mode in ("sensors", "all")
        if has_sensors and not self.scene.can_render():
            self._setup_sensors(options)

    def _setup_sensors(self, options: dict) -> None:
        """Set up the cameras, those of the rasteriser where SAPIEN does not draw."""
        if self.scene.can_render():
            super()._setup_sensors(options)
            return
        self._raster_view, self._sensors = self._rasterized_cameras()
        self._sensor_configs = {uid: camera.config for uid, camera in self._sensors.items()}
        self.scene.sensors = self._sensors

    def _rasterized_cameras(self) -> tuple[SolverScene, dict[str, RasterCamera]]:
        """Return cameras of the rasteriser, set up as the task, the agents and the user want them, and what they see."""
        configs = {**parse_camera_configs(self._default_sensor_configs), **parse_camera_configs(self.agent._sensor_configs)}
        configs = camera_configs(configs, self._custom_sensor_configs, "sensor_configs")
        others = None if self.scene.arms is None else arm_bodies([agent.robot for agent in self._agents])
        view = SolverScene(self.solver, has_table=self.HAS_TABLE, others=others)
        carriers: dict[str, Any] = {name: link for agent in self._agents for name, link in agent.robot.links_map.items()}
        positions = self.solver.gripper_positions
        carriers |= {f"gripper_{index}": GripperMount(positions, index) for index in range(self.num_grippers)}
        for index, agent in enumerate(self._agents if self.scene.arms is not None else ()):
            carriers |= {f"arm_{index}/{link}": LinkMount(agent.robot, link) for link in link_frames(agent.robot)}
        sensor = self._depth_sensor
        cameras = {
            uid: RasterCamera(config, view, carriers, sensor, partial(self.observation_seeds, index))
            for index, (uid, config) in enumerate(configs.items())
        }
        self._raster_cameras += cameras.values()
        return view, cameras

    def _has_random_observations(self) -> bool:
        """Tell whether anything in observations is random."""
        return self._depth_sensor is not None

    def _set_up_observations(self) -> None:
        """Begin anew with cameras and random numbers, before cameras are set up."""
        self._raster_cameras: list[RasterCamera] = []
        is_random = self._has_random_observations()
        self._observation_noise = self.episode_tensor("observation_noise", kind="scalar") if is_random else None

    def _start_observing(self, worlds: torch.Tensor) -> None:
        if self._observation_noise is not None:
            (draws,) = self.draw_uniform(worlds, 1)
            self._observation_noise[worlds] = draws[:, 0]
        for camera in self._raster_cameras:
            camera.check_place(worlds)

    def observation_seeds(self, stream: int) -> torch.Tensor:
        """Return a seed for what is random in an observation of each world now, (B,) int32; another one for another stream."""
        drawn = ((self._observation_noise + 1.0) * 2**23).long()
        mixed = drawn * 1_000_003 + self._elapsed_steps.long() * 7_919 + stream * 104_729
        return (mixed % 2**31).int()

    def _rasterize_sensors(self, apply_texture_transforms: bool) -> dict[str, dict[str, torch.Tensor]]:
        """Return what the cameras see in all worlds."""
        self._raster_view.update()
        self.capture_sensor_data()
        wanted = asdict(self.obs_mode_struct.visual)
        images = {
            uid: camera.get_obs(**wanted, apply_texture_transforms=apply_texture_transforms)
            for uid, camera in self._sensors.items()
        }
        if self._obs_mode == "pointcloud":  # ManiSkill makes the points of these, and they need not be rounded
            for uid, camera in self._sensors.items():
                images[uid]["position"] = camera.positions() * MILLIMETRES
        return images

    def _get_obs_sensor_data(self, apply_texture_transforms: bool = True) -> dict:
        if self._raster_view is not None:
            return self._rasterize_sensors(apply_texture_transforms)
        images = []
        for world in self._drawn_worlds:
            self._painter.show(self.checked_drawing(world), hide_goal=True)
            images.append(super()._get_obs_sensor_data(apply_texture_transforms))
        return {
            camera: {name: torch.cat([image[camera][name] for image in images]) for name in textures}
            for camera, textures in images[0].items()
        }

    def _picture_worlds(self, take_picture: Callable[[], torch.Tensor], *, has_frames: bool = False) -> torch.Tensor:
        """Take a picture (1, H, W, 3) or (H, W, 3) of each world, and stack them."""
        self.evaluate()  # whoever asks for pictures may have written into the worlds
        pictures = []
        try:
            for world in range(min(self.num_envs, MAX_DRAWN_WORLDS)):
                self._drawn_worlds = range(world, world + 1)
                drawing = self.checked_drawing(world)
                self._painter.show(drawing)
                picture = take_picture()
                picture = picture if picture.ndim == 4 else picture[None]
                pictures.append(_framed(picture) if has_frames and drawing.is_solved else picture)
        finally:
            self._drawn_worlds = range(self.num_envs)
        return torch.cat(pictures)


def _framed(pictures: torch.Tensor) -> torch.Tensor:
    """Return pictures (n, H, W, 3) uint8 with a frame in the colour of success."""
    color = torch.tensor(palette.SOLVED, device=pictures.device).mul(255.0).round().to(torch.uint8)
    width = max(round(FRAME_WIDTH * pictures.shape[1]), 1)
    framed = color.expand_as(pictures).clone()
    framed[:, width:-width, width:-width] = pictures[:, width:-width, width:-width]
    return framed
