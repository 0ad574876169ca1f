"""ClothHanging-v1: bring a cloth with a hole onto a peg, or drape one over a bar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from mani_skill.utils.geometry.rotation_conversions import quaternion_to_matrix
from mani_skill.utils.registration import register_env

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Collider, Model, cloth
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.geometry.bar_hanger import BarHanger
from maniskill_grpd.tasks.geometry.cloth_seat import check_hole, hole_outline, ring_about_middle, spread_corners
from maniskill_grpd.tasks.geometry.cloth_shapes import RESOLUTIONS, check_cloth_shapes, cloth_outline
from maniskill_grpd.tasks.geometry.direction_draws import directions_in_cap, orientations_in_cap, tilts_of_z
from maniskill_grpd.tasks.geometry.hanger import Hanger, Hanging
from maniskill_grpd.tasks.geometry.peg_hanger import PegHanger
from maniskill_grpd.tasks.measurement import Metric
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.options.gripper_teams import gripper_teams
from maniskill_grpd.tasks.options.resolutions import check_resolutions
from maniskill_grpd.tasks.pictures.collider_solids import collider_solids
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet

CLOTH_AREA = 0.16
"""Area of the cloth's outline [m^2]: a square of 40 cm."""
HOLE_RADIUS = 0.06
"""Default radius of the hole [m]."""

HANGER_OFFSET = Channel("hanger_offset", "vector", "m", "tip of the peg (nearest point of the bar) minus position, design")
HANGER_AXIS = Channel("hanger_axis", "vector", "", "unit vector out of the peg's tip (along the bar), design")
HANGER_DISTANCE = Channel("hanger_distance", "scalar", "m", "d_v, eq. 42: distance from the surface of peg or bar")
SEAT = Channel("seat", "scalar", "", "1 on the boundary of the hole (of the disc that comes onto the bar), design")
SEAT_OFFSET = Channel("seat_offset", "vector", "m", "hanger_offset of the middle of the seat, design")
SEAT_NORMAL = Channel("seat_normal", "vector", "", "unit area vector of the seat, out of the front of the cloth, design")
SEAT_DEPTH = Channel("seat_depth", "scalar", "m", "how far the middle of the seat has come down the hanger, design")


@register_env("ClothHanging-v1", max_episode_steps=100)
class ClothHangingEnv(DeformableEnv):
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
    SUPPORTED_ROBOTS = gripper_teams(GRIPPER_COUNTS)
    HAS_TABLE = False
    PROGRESS = Metric("way_to_hanger", "m")
    OBJECT_CHANNELS = (channels.VELOCITY, HANGER_OFFSET, HANGER_AXIS, HANGER_DISTANCE, SEAT, channels.CORNER, channels.HELD)
    GRIPPER_CHANNELS = (
        channels.VELOCITY,
        HANGER_OFFSET,
        HANGER_AXIS,
        SEAT_OFFSET,
        SEAT_NORMAL,
        HANGER_DISTANCE,
        SEAT_DEPTH,
        channels.GRIPPER_STATUS,
    )

    CAMERA_POSITION = (-0.9, -2.3, 1.1)  # from there it sees hangers in all directions from the origin
    CAMERA_TARGET = (0.0, 0.0, 0.0)
    CAMERA_FOV = 0.75

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
    PROGRESS_WEIGHT = 0.2
    """Share for coming down the hanger."""
    SUCCESS_WEIGHT = 0.5
    """Share for success; with release a fifth of it is for opening grippers while the cloth hangs."""

    hanging: Hanging
    """How the cloths hang, as `evaluate` last measured it."""
    rest_positions: torch.Tensor
    """Nodes of all variants in the flat cloth, padded, (M, N, 3) [m]."""
    seat_nodes: torch.Tensor
    """Nodes around the seat of all variants in order, the last repeated, (M, L) int64."""

    def __init__(
        self,
        *,
        hanger: str = "peg",
        release: bool = False,
        shapes: str | Sequence[str] = "square",
        resolution: int | Sequence[int] = 100,
        hole_radius: float | None = None,
        **settings: Any,
    ) -> None:
        """Set up the task.

        Args:
            hanger: "peg" or "bar".
            release: Whether the grippers must let the cloth go; then `grasp` is "free" by default.
            shapes: Names of the cloth's outline, see `CLOTH_SHAPES`; of several, each episode draws one.
            resolution: Number of nodes of the cloth, 49 to 1225, that of its mesh is about as large; of several, each episode
                draws one.
            hole_radius: Radius of the hole for a peg, 0.03 to 0.1 m, with at least 3 cm of cloth around; 0.06 by default.
            settings: Options of `DeformableEnv`; `num_grippers` is 3 or 4 (default).

        Raises:
            ValueError: If an option has a value that is not allowed, or options contradict each other; says why.
        """
        if hanger not in ("peg", "bar"):
            raise ValueError(f"hanger must be one of ['peg', 'bar'], got {hanger!r}")
        if hanger == "bar" and hole_radius is not None:
            raise ValueError(f"a cloth that is draped over a bar has no hole, got hole_radius={hole_radius}")
        if settings.get("num_grippers") in (1, 2):
            raise ValueError(
                "num_grippers must be 3 or 4: two hands cannot turn a cloth about the line between them, "
                f"got {settings['num_grippers']}"
            )
        self.shapes = check_cloth_shapes(shapes)
        self.resolutions = check_resolutions(resolution, *RESOLUTIONS)
        self.release = release
        self.hole_radius = None if hanger == "bar" else HOLE_RADIUS if hole_radius is None else hole_radius
        if self.hole_radius is not None:
            for name in self.shapes:
                check_hole(name, CLOTH_AREA, self.hole_radius)
        self._hanger: Hanger = BarHanger() if self.hole_radius is None else PegHanger(self.hole_radius, self.TILT_RANGE[release])
        super().__init__(**(_with_free_grasp(settings) if release else settings))

    # ------------------------------------------------------------------ episode

    def _build_models(self) -> list[Model]:
        models = []
        for name in self.shapes:
            holes = [] if self.hole_radius is None else [hole_outline(name, CLOTH_AREA, self.hole_radius)]
            outline = cloth_outline(name, CLOTH_AREA)
            models += [cloth(outline, holes, num_nodes=num) for num in self.resolutions]
        return models

    def _build_colliders(self) -> Sequence[Collider]:
        return self._hanger.colliders

    def _candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        return spread_corners(model, self.num_grippers)

    def _allocate_episode(self) -> None:
        self.hanger_point = self._episode_tensor("hanger_point", 3, kind="position")
        self.hanger_axis = self._episode_tensor("hanger_axis", 3, kind="vector")
        self._open_steps = self._episode_tensor("open_steps", kind="scalar")
        self._hanger.attach(self.solver)
        count, num_nodes = len(self.models), self.solver.num_nodes
        loops = [ring_about_middle(m) if self.hole_radius is None else m.node_sets["hole_0"] for m in self.models]
        longest = max(len(loop) for loop in loops)
        flat, in_seat = np.zeros((count, num_nodes, 3), np.float32), np.zeros((count, num_nodes), np.float32)
        for index, (model, loop) in enumerate(zip(self.models, loops, strict=True)):
            flat[index, : model.num_nodes] = model.rest_positions
            in_seat[index, loop] = 1.0
        seats = np.stack([np.pad(loop, (0, longest - len(loop)), mode="edge") for loop in loops])
        corners = np.stack([self._candidate_gripper_nodes(model) for model in self.models])
        self.rest_positions, self._in_seat, self.seat_nodes, self._held_nodes = (
            torch.as_tensor(table, device=self.device) for table in (flat, in_seat, seats, corners)
        )

    def _start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        variant = self.solver.variants[worlds].long()
        draws = self._draw_uniform(worlds, 11)
        angle = self.ANGLE_RANGE * self._pose_share
        turn = quaternion_to_matrix(orientations_in_cap(draws[:, 0:3], angle))
        centre = self.CENTRE_RANGE * self._pose_share * draws[:, None, 3:6]
        self._place_hanger(worlds, draws[:, 6:11], angle)
        self._open_steps[worlds] = 0.0
        return self.rest_positions[variant] @ turn.mT + centre, self._held_nodes[variant]

    def _place_hanger(self, worlds: torch.Tensor, draws: torch.Tensor, angle: float) -> None:
        """Place the hangers of some worlds by draws in [-1, 1) (b, 5), at most `angle` away from the x axis."""
        nearest, farthest = self._hanger.distances
        distance = nearest + (farthest - nearest) * (draws[:, 2:3] + 1.0) / 2.0
        middles = distance * directions_in_cap(draws[:, 0:2], angle).roll(1, dims=-1)  # from about z to about x
        axes = self._hanger.draw_axes(draws[:, 3:5], self._pose_share)
        self.hanger_point[worlds], self.solver.collider_positions[worlds] = self._hanger.place(middles, axes)
        self.hanger_axis[worlds] = axes
        self.solver.collider_rotations[worlds] = tilts_of_z(axes)[:, None]

    # ------------------------------------------------------------------ one control step

    def _after_simulation_step(self) -> None:
        super()._after_simulation_step()
        all_open = ~self.solver.closed.any(dim=1)
        self._open_steps.copy_(torch.where(all_open, self._open_steps + 1.0, 0.0))

    def seat_loop(self) -> torch.Tensor:
        """Return the boundary of the part of the cloth that comes onto the hanger, (B, L, 3) [m], the last point repeated."""
        nodes = self.seat_nodes[self.solver.variants.long()]
        return self.solver.positions.gather(1, nodes[..., None].expand(-1, -1, 3))

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Measure how the cloth hangs; observation and reward reuse it."""
        self.hanging = self._hanger.measure(self.solver, self.seat_loop(), self.hanger_point, self.hanger_axis)
        fail = self.solver.frozen.clone()
        success = self.hanging.is_hung & ~fail
        if self.release:
            success = success & (self._open_steps >= self.OPEN_STEPS)
        return {
            "success": success,
            "fail": fail,
            "is_hung": self.hanging.is_hung,
            "way_to_hanger": self.hanging.way,
            **self.hanging.measures,
        }

    def compute_dense_reward(self, obs: Any, action: torch.Tensor, info: dict) -> torch.Tensor:
        """Return rewards in [0, 1], (B,); 0 after a failure."""
        hanging, done = self.hanging, info["success"].float()
        if self.release:
            done = 0.8 * done + 0.2 * (~self.solver.closed).float().mean(dim=1) * hanging.is_hung
        near = 1.0 - torch.tanh(hanging.way / self.WAY_SCALE)
        reward = (
            self.WAY_WEIGHT * near
            + self.ALIGNMENT_WEIGHT * near * hanging.alignment
            + self.PROGRESS_WEIGHT * hanging.progress
            + self.SUCCESS_WEIGHT * done
        )
        return reward * ~info["fail"]

    def _object_values(self) -> dict[str, torch.Tensor]:
        seat = self._in_seat[self.solver.variants.long()]
        return {**self._hanger_values(self.solver.positions), "seat": seat}

    def _gripper_values(self) -> dict[str, torch.Tensor]:
        grippers, hanging = self.solver.gripper_positions, self.hanging
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

    def _get_obs_extra(self, info: dict) -> dict[str, torch.Tensor]:
        obs = {"hanger_point": self.hanger_point.clone(), "hanger_axis": self.hanger_axis.clone()}
        if self.obs_mode_struct.use_state:
            obs["cloth_positions"] = self.solver.positions.flatten(1).clone()
            obs["cloth_velocities"] = self.solver.velocities.flatten(1).clone()
        return obs

    # ------------------------------------------------------------------ pictures

    def _drawing(self, world: int) -> Drawing:
        solver, model = self.solver, self._model_of(world)
        return Drawing(
            object=Sheet(self._nodes_of(world, solver.positions), model.faces),
            solids=collider_solids(solver, world),
            grippers=solver.gripper_positions[world].cpu().numpy(),
            closed=solver.closed[world].cpu().numpy(),
            is_solved=bool(self.evaluate()["success"][world]),
            has_table=self.HAS_TABLE,
        )


def _with_free_grasp(settings: dict[str, Any]) -> dict[str, Any]:
    """Let grippers open by default, and refuse settings under which they cannot."""
    if settings.get("grasp") == "fixed" or settings.get("control_mode") == "pd_ee_delta_pos":
        raise ValueError("release=True needs grippers that open: grasp='free', control_mode='pd_ee_delta_pos_grip'")
    return {**settings, "grasp": "free"}
