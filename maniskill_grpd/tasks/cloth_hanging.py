"""ClothHanging-v1: bring a cloth with a hole onto a peg, or drape one over a bar."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.geometry.rotation_conversions import quaternion_to_matrix
from mani_skill.utils.registration import register_env

from maniskill_grpd.physics import Collider, Model, cloth
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.geometry.bar_hanger import BarHanger
from maniskill_grpd.tasks.geometry.cloth_seat import check_middle, hole_outline, ring_about_middle, spread_corners
from maniskill_grpd.tasks.geometry.cloth_shapes import RESOLUTIONS, check_cloth_shapes, cloth_outline
from maniskill_grpd.tasks.geometry.direction_draws import directions_in_cap, orientations_in_cap, tilts_of_z
from maniskill_grpd.tasks.geometry.hanger import HANGER_AXIS, SEAT, SEAT_DEPTH, SEAT_NORMAL, SEAT_OFFSET, Hanger, Hanging
from maniskill_grpd.tasks.geometry.loop_geometry import loop_area
from maniskill_grpd.tasks.geometry.mesh_outlines import GivenMesh
from maniskill_grpd.tasks.geometry.peg_hanger import PegHanger
from maniskill_grpd.tasks.geometry.shape_registry import GivenShape, Shape
from maniskill_grpd.tasks.measurement import Measurement, Metric
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.options.arm_bases import beside_the_way
from maniskill_grpd.tasks.options.grasp_mode import with_release
from maniskill_grpd.tasks.options.resolutions import check_resolutions

CLOTH_AREA = 0.16
"""Area of the cloth's outline [m^2]: a square of 40 cm."""
HOLE_RADIUS = 0.06
"""Default radius of the hole [m]."""


@dataclass(frozen=True, kw_only=True)
class HangingMeasurement(Measurement):
    """How cloths hang."""

    hanging: Hanging


@register_env("ClothHanging-v1", max_episode_steps=100)
class ClothHangingEnv(DeformableEnv, BaseEnv):
    """
    **Task Description:**
    Four floating grippers (optionally three) hold a cloth by its corners in the air and must bring
    it onto a peg of any position and direction, through a hole of 6 cm radius in the middle of the
    cloth. The peg is 0.25 m long and 3 cm thick and stands on a round plate. The cloth has an area
    of 0.16 m^2 and is a square by default. There is no table; gravity acts.

    With `hanger="bar"` a cloth without a hole must be draped over a bar, 0.6 m long and 2 cm thick.
    With `release=True` the grippers must open afterwards, and the cloth must stay.

    **Randomizations:**
    - the middle of the cloth is uniform in the cube [-0.1, 0.1]^3 m
    - the orientation of the flat cloth is uniform over all rotations: its normal is within 180
      degrees of the vertical, its turn about the normal in [-180, 180] degrees
    - the direction in which the hanger's middle lies from the origin is uniform within 180 degrees
      of the x axis, the distance uniform in [0.75, 0.85] m, for a bar in [0.85, 0.95] m
    - the direction of the peg is uniform within 180 degrees of the vertical, with `release=True`
      within 45 degrees, so that a cloth that is let go slides onto the plate and not off the tip
    - a bar is turned about the vertical by an angle uniform in [-90, 90] degrees, its slope uniform
      in [-15, 15] degrees
    - with `shapes=("square", "hexagon", ...)` and `resolution=(100, 400, ...)` each episode draws
      one combination of shape and resolution
    - `pose_range="half"` and `"quarter"` shrink all ranges but that of the distance to a half and a
      quarter
    - with arms all ranges but that of the distance are a quarter of these, and the distance of the hanger
      is in [0.55, 0.65] m, for a bar in [0.65, 0.75] m; what an arm cannot reach is drawn anew

    **Success Conditions:**
    - peg: the peg's axis passes through the boundary of the hole; the middle of the hole is at
      least 0.08 m down from the tip along the axis and above the plate; the normal of the hole is
      within 35 degrees of the axis, up to sign
    - bar: where the cloth crosses the vertical plane through the bar within 0.04 m of the bar's
      axis, which it does, it is above the axis; its middle (of a disc of 5 cm radius) is at most
      0.05 m from the axis; on both sides at least 0.25 of the cloth's mass hangs below the axis
    - `release=True`: all this after all grippers have been open for one second (20 steps)

    **Fail Conditions:**
    - the simulation of the world has diverged; it stands still until it is reset

    **Goal Specification:**
    - the point (tip of the peg, middle of the bar) and the axis of the hanger, each (3,)
    """  # noqa: D200, D205, D212, D400, D415  (the form of ManiSkill's task cards)

    GRIPPER_COUNTS = (3, 4)
    DEFAULT_NUM_GRIPPERS = 4
    HAS_TABLE = False
    TRAINING = {
        "env_kwargs": ("resolution=64", "graph_nodes=25"),
        "num_envs": 16,
        "num_minibatches": 4,
        "gamma": 0.95,
        "noise_correlation": 0.5,
        "noise_schedule": "linear",
    }
    PROGRESS = Metric("way_to_hanger", "m")

    CAMERA_POSITION = (-0.9, -2.3, 1.1)  # from there it sees hangers in all directions from the origin
    CAMERA_TARGET = (0.0, 0.0, 0.0)
    CAMERA_FOV = 0.75

    ARM_CAMERA = ((1.6, -2.0, 1.2), (0.3, 0.0, 0.0), 0.85)
    ARM_SHARE = 0.25
    """Share of the ranges that is sampled with arms."""
    ARM_DISTANCE = -0.2
    """What is added to the distance of hangers with arms [m]."""

    CENTRE_RANGE = 0.1
    """Largest coordinate of the middle of the cloth [m]."""
    ANGLE_RANGE = np.pi
    """Largest angle of the cloth's normal to the vertical, of its turn, and of the direction of the hanger to x [rad]."""
    TILT_RANGE = {False: np.pi, True: np.deg2rad(45.0)}
    """Largest angle of the peg to the vertical, without and with release [rad]."""
    OPEN_STEPS = 20
    """Success with release: how many steps all grippers must have been open."""

    # A cloth that waits before the hanger must earn clearly less than one that hangs (docs/decisions.md).
    WAY_WEIGHT = 0.2
    """Share of the reward that draws the seat to the hanger from anywhere."""
    WAY_SCALE = 0.5
    """Way [m] at which that share has fallen to a quarter."""
    ALIGNMENT_WEIGHT = 0.1
    """Share for turning the cloth, felt near the hanger."""
    SPREAD_WEIGHT = 0.05
    """Share for a cloth that is spread between its grippers, or on the hanger: the seat of a slack one does not follow them."""
    FULL_SPREAD = 0.7
    """Share of the flat cloth's area between the grippers at which it is earned in full."""
    PROGRESS_WEIGHT = 0.3
    """Share for the last 8 cm before the hanger and for coming down it."""
    SUCCESS_WEIGHT = 0.35
    """Share for success; with release a fifth of it is for opening grippers while the cloth hangs."""

    rest_positions: torch.Tensor
    """Nodes of all variants in the flat cloth, padded, (M, N, 3) [m]."""
    seat_nodes: torch.Tensor
    """Nodes around the seat of all variants in order, the last repeated, (M, L) int64."""

    def __init__(
        self,
        *,
        hanger: str = "peg",
        release: bool = False,
        shapes: GivenShape | GivenMesh | Iterable[GivenShape | GivenMesh] = "square",
        resolution: int | Sequence[int] = 100,
        hole_radius: float | None = None,
        hole_center: Sequence[float] | None = None,
        **settings: Any,
    ) -> None:
        """Set up the task.

        Args:
            hanger: "peg" or "bar".
            release: Whether the grippers must let the cloth go; then `grasp` is "free" by default.
            shapes: The cloth's outline, a name ("square" by default, "rectangle", "triangle", "hexagon", "circle", "l_shape", or
                one of `register_cloth_shape`) or a polygon (P, 2) [m], which keeps its size, or a flat mesh (a
                `trimesh.Trimesh`, or vertices and faces), whose rim counts; of several, each episode draws one.
            resolution: Number of nodes of the cloth, 49 to 1225, that of its mesh is about as large; of several, each episode
                draws one.
            hole_radius: Radius of the hole for a peg, 0.03 to 0.1 m, with at least 3 cm of cloth around; 0.06 by default.
            hole_center: Centre of the hole in the coordinates of the outline, (2,) [m]; by default the point that is farthest
                from the outline.
            settings: Options of `DeformableEnv`; `num_grippers` is 3 or 4 (default).

        Raises:
            ValueError: If an option has a value that is not allowed, or options contradict each other; says why.
        """
        if hanger not in ("peg", "bar"):
            raise ValueError(f"hanger must be one of ['peg', 'bar'], got {hanger!r}")
        if hanger == "bar" and not (hole_radius is None and hole_center is None):
            given = f"hole_radius={hole_radius}, hole_center={hole_center}"
            raise ValueError(f"a cloth that is draped over a bar has no hole, got {given}")
        if settings.get("num_grippers") in (1, 2):
            raise ValueError(
                "num_grippers must be 3 or 4: two hands cannot turn a cloth about the line between them, "
                f"got {settings['num_grippers']}"
            )
        self.shapes = check_cloth_shapes(shapes, CLOTH_AREA)
        self.resolutions = check_resolutions(resolution, *RESOLUTIONS)
        self.release = release
        self.hole_radius = None if hanger == "bar" else HOLE_RADIUS if hole_radius is None else hole_radius
        self._holes = [self._cut_hole(shape, hole_center) for shape in self.shapes]
        self._hanger: Hanger = BarHanger() if self.hole_radius is None else PegHanger(self.hole_radius, self.TILT_RANGE[release])
        offset, distance = self._hanger.channels
        self.OBJECT_CHANNELS = (channels.VELOCITY, offset, HANGER_AXIS, distance, SEAT, channels.CORNER, channels.HELD)
        self.RICH_GRIPPER_CHANNELS = (
            channels.VELOCITY,
            offset,
            HANGER_AXIS,
            SEAT_OFFSET,
            SEAT_NORMAL,
            distance,
            SEAT_DEPTH,
            channels.GRIPPER_STATUS,
        )
        super().__init__(**(with_release(settings) if release else settings))

    # ------------------------------------------------------------------ episode

    def build_models(self) -> list[Model]:
        """Build a cloth of each shape and resolution, with a hole for a peg."""
        models = []
        for shape, holes in zip(self.shapes, self._holes, strict=True):
            outline = cloth_outline(shape, CLOTH_AREA)
            models += [cloth(outline, holes, num_nodes=num) for num in self.resolutions]
        return models

    def _cut_hole(self, shape: Shape, center: Sequence[float] | None) -> list[np.ndarray]:
        """Return the hole of a cloth for a peg; a cloth for a bar has none, but its middle must be within it."""
        if self.hole_radius is None:
            check_middle(shape, CLOTH_AREA)
            return []
        return [hole_outline(shape, CLOTH_AREA, self.hole_radius, center)]

    def build_colliders(self) -> Sequence[Collider]:
        """Build the hanger."""
        return self._hanger.colliders

    def candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        """Return as many corners as there are grippers."""
        return spread_corners(model, self.num_grippers)

    @classmethod
    def default_arm_bases(cls, num_arms: int) -> np.ndarray:
        """See `DeformableEnv`: on both sides of the way to the hanger."""
        return beside_the_way(num_arms)

    @property
    def _share(self) -> float:
        """Share of the ranges that is sampled."""
        return self.pose_share * (self.ARM_SHARE if self._bases is not None else 1.0)

    def allocate_episode(self) -> None:
        """Create the pose of the hanger, the clock of open grippers, and tables of cloths."""
        self.hanger_point = self.episode_tensor("hanger_point", 3, kind="position")
        self.hanger_axis = self.episode_tensor("hanger_axis", 3, kind="vector")
        self._open_steps = self.episode_tensor("open_steps", kind="scalar")
        self._hanger.attach(self.solver)
        loops = [ring_about_middle(m) if self.hole_radius is None else m.node_sets["hole_0"] for m in self.models]
        self.rest_positions = self.node_table([model.rest_positions for model in self.models])
        self._in_seat = self.node_table(
            [np.isin(np.arange(m.num_nodes), loop).astype(np.float32) for m, loop in zip(self.models, loops, strict=True)]
        )
        self.seat_nodes = self.variant_table(loops)
        self._held_nodes = self.variant_table([self.candidate_gripper_nodes(model) for model in self.models])

    def start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Place the hanger, and the flat cloth away from it."""
        variant = self.variants[worlds]
        turn, centre, direction, distance, axis = self.draw_uniform(worlds, 3, 3, 2, 1, 2)
        angle = self.ANGLE_RANGE * self._share
        turn = quaternion_to_matrix(orientations_in_cap(turn, angle))
        centre = self.CENTRE_RANGE * self._share * centre[:, None]
        self._place_hanger(worlds, directions_in_cap(direction, angle), distance, axis)
        self._open_steps[worlds] = 0.0
        return self.rest_positions[variant] @ turn.mT + centre, self._held_nodes[variant]

    def _place_hanger(self, worlds: torch.Tensor, direction: torch.Tensor, distance: torch.Tensor, axis: torch.Tensor) -> None:
        """Place the hangers of some worlds.

        Args:
            worlds: (b,).
            direction: Where the hangers' middles lie, unit vectors about z that are turned to x, (b, 3).
            distance: How far away, in [-1, 1), (b, 1).
            axis: Where they point, in [-1, 1), (b, 2).
        """
        shift = self.ARM_DISTANCE if self._bases is not None else 0.0
        nearest, farthest = (bound + shift for bound in self._hanger.distances)
        distance = nearest + (farthest - nearest) * (distance + 1.0) / 2.0
        middles = distance * direction.roll(1, dims=-1)  # from about z to about x
        axes = self._hanger.draw_axes(axis, self._share)
        self.hanger_point[worlds], self.solver.collider_positions[worlds] = self._hanger.place(middles, axes)
        self.hanger_axis[worlds] = axes
        self.solver.collider_rotations[worlds] = tilts_of_z(axes)[:, None]

    def points_to_reach(self, worlds: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Return the point of the hanger, from which no gripper will be far."""
        return self.hanger_point[worlds, None, None].expand(-1, nodes.shape[1], -1, -1)

    # ------------------------------------------------------------------ one control step

    def _after_simulation_step(self) -> None:
        super()._after_simulation_step()
        all_open = ~self.solver.closed.any(dim=1)
        self._open_steps.copy_(torch.where(all_open, self._open_steps + 1.0, 0.0))

    def seat_loop(self) -> torch.Tensor:
        """Return the boundary of the part of the cloth that comes onto the hanger, (B, L, 3) [m], the last point repeated."""
        nodes = self.seat_nodes[self.variants]
        return self.solver.positions.gather(1, nodes[..., None].expand(-1, -1, 3))

    def measure(self) -> HangingMeasurement:
        """Measure how the cloth hangs."""
        hanging = self._hanger.measure(self.solver, self.seat_loop(), self.hanger_point, self.hanger_axis)
        success = hanging.is_hung
        if self.release:
            success = success & (self._open_steps >= self.OPEN_STEPS)
        metrics = {"is_hung": hanging.is_hung, "way_to_hanger": hanging.way, **hanging.measures}
        return HangingMeasurement(success=success, metrics=metrics, hanging=hanging)

    def reward(self, measurement: HangingMeasurement) -> torch.Tensor:
        """Return rewards in [0, 1], (B,)."""
        hanging, done = measurement.hanging, measurement.success.float()
        if self.release:
            done = 0.8 * done + 0.2 * (~self.solver.closed).float().mean(dim=1) * hanging.is_hung
        near = 1.0 - torch.tanh(hanging.way / self.WAY_SCALE)
        return (
            self.WAY_WEIGHT * near
            + self.SPREAD_WEIGHT * self._spread(hanging)
            + self.ALIGNMENT_WEIGHT * near * hanging.alignment
            + self.PROGRESS_WEIGHT * hanging.progress
            + self.SUCCESS_WEIGHT * done
        )

    def _spread(self, hanging: Hanging) -> torch.Tensor:
        """Return how far the cloth is spread between the nodes at which it was taken, in [0, 1], (B,); 1 on the hanger."""
        flat, now = self.rest_positions[self.variants], self.solver.positions
        areas = [torch.linalg.vector_norm(loop_area(self.at_start_nodes(points)), dim=-1) for points in (now, flat)]
        return torch.where(hanging.is_on, 1.0, (areas[0] / (self.FULL_SPREAD * areas[1])).clamp(max=1.0))

    def object_values(self, measurement: HangingMeasurement) -> dict[str, torch.Tensor]:
        """Return where the hanger is, seen from the nodes, and which of them come onto it."""
        return {**self._hanger_values(self.solver.positions), "seat": self._in_seat[self.variants]}

    def gripper_values(self, measurement: HangingMeasurement) -> dict[str, torch.Tensor]:
        """Return where the hanger is, seen from the grippers and from the seat."""
        grippers, hanging = self.solver.gripper_positions, measurement.hanging
        return {
            **self._hanger_values(grippers),
            "seat_offset": hanging.offset[:, None].expand_as(grippers),
            "seat_normal": hanging.normal[:, None].expand_as(grippers),
            "seat_depth": hanging.depth[:, None].expand(grippers.shape[:2]),
        }

    def _hanger_values(self, points: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return where the hanger is, seen from points (B, n, 3) [m]."""
        pose = self.hanger_point, self.hanger_axis
        return {
            "hanger_offset": self._hanger.offsets(points, *pose),
            "hanger_axis": self.hanger_axis[:, None].expand_as(points),
            "hanger_distance": self._hanger.distances_to(points, *pose),
        }

    def goal_observations(self) -> dict[str, torch.Tensor]:
        """Return the point and the axis of the hanger."""
        return {"hanger_point": self.hanger_point, "hanger_axis": self.hanger_axis}
