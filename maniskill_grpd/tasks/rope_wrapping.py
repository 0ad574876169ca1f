"""RopeWrapping-v1: close a rope around a post."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.geometry.rotation_conversions import quaternion_to_matrix
from mani_skill.utils.registration import register_env

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Collider, Model, rope
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.geometry.posts import POST_HEIGHT, POSTS
from maniskill_grpd.tasks.geometry.winding import winding_number
from maniskill_grpd.tasks.measurement import Measurement, Metric
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.observation.node_statistics import mean_over_nodes
from maniskill_grpd.tasks.options.resolutions import check_resolutions

ROPE_LENGTH = 0.8
"""Length of the rope [m]."""
RESOLUTIONS = (20, 200)
"""Smallest and largest number of nodes."""

POST_CHANNELS = (
    Channel("post_axis", "vector", "", "unit vector from the base of the post to its top, design"),
    Channel(
        "post_offset",
        "vector",
        "m",
        "nearest point of the post's axis minus position, design",
        starts_at="node",
        across="post_axis",
    ),
    Channel("post_distance", "scalar", "m", "distance from the post's axis, design", distance_of="post_offset"),
    Channel("post_height", "scalar", "m", "height above the base of the post, along its axis, design", along="post_axis"),
    *(Channel(f"post_is_{shape}", "scalar", "", f"1 where the post is a {shape}, design") for shape in POSTS),
)
PARTNER_OFFSET = Channel(
    "partner_offset", "vector", "m", "position of the other gripper minus position, design", starts_at="node", ends_at="partner"
)
PARTNER_DISTANCE = Channel(
    "partner_distance", "scalar", "m", "distance of the other gripper, design", distance_of="partner_offset"
)
WINDING = Channel("winding", "scalar", "", "|winding number| of the rope about the post, design")


@dataclass(frozen=True, kw_only=True)
class WrappingMeasurement(Measurement):
    """How far a rope is closed around its post."""

    post_rotation: torch.Tensor
    """The axes of the post's frame are its columns, (B, 3, 3)."""
    rope: torch.Tensor
    """The nodes in the frame of the post, (B, N, 3) [m]."""


@register_env("RopeWrapping-v1", max_episode_steps=100)
class RopeWrappingEnv(DeformableEnv, BaseEnv):
    """
    **Task Description:**
    A rope of 0.8 m lies straight on a table, beside a fixed post of 0.15 m height: a cylinder (radius
    0.06 m), a box (0.1 m x 0.1 m) or a triangular prism (corners 0.08 m from its axis). Two floating
    grippers hold the ends of the rope and must close it around the post.

    **Randomizations:**
    - the position of the post is uniform in the square [-0.15, 0.15] m x [-0.15, 0.15] m
    - its direction is uniform in [-180, 180] degrees
    - the direction of the rope is uniform in [-180, 180] degrees
    - the rope's line passes the axis of the post, on either side, at a distance uniform in [0.1, 0.3] m
    - the middle of the rope is off the point of its line nearest to the post by an amount uniform in
      [-0.15, 0.15] m along the rope
    - with `shapes=("cylinder", "box", "prism")`, or some of them, each episode draws one of the shapes
    - all draws are independent, and no two of their values make rope and post overlap
    - `pose_range="half"` and `"quarter"` shrink all these ranges to a half and a quarter, that of the
      distance from above: to [0.1, 0.2] m and [0.1, 0.15] m

    **Success Conditions:**
    - the rope winds around the axis of the post, |winding number| at least 0.95
    - its ends are at most 0.05 m apart
    - every node is at the height of the post, between its base and its top

    **Fail Conditions:**
    - the simulation of the world has diverged; it stands still until it is reset

    **Goal Specification:**
    - the pose of the post, position of its middle and rotation (w, x, y, z), (7,)
    """  # noqa: D200, D205, D212, D400, D415  (the form of ManiSkill's task cards)

    GRIPPER_COUNTS = (2,)
    DEFAULT_NUM_GRIPPERS = 2
    TRAINING = {"num_envs": 16, "num_minibatches": 4}
    PROGRESS = Metric("winding", "")
    OBJECT_CHANNELS = (channels.VELOCITY, *POST_CHANNELS, channels.ARC, channels.HELD, channels.CONTACT)
    RICH_GRIPPER_CHANNELS = (
        channels.VELOCITY,
        *POST_CHANNELS,
        PARTNER_OFFSET,
        PARTNER_DISTANCE,
        WINDING,
        channels.ARC,
        channels.GRIPPER_STATUS,
    )

    CENTRE_RANGE = 0.15
    """Largest coordinate of the post [m]."""
    YAW_RANGE = np.pi
    """Largest angle of post and rope about the vertical [rad]."""
    PASSING_RANGE = (0.1, 0.3)
    """Distance at which the rope passes the post's axis [m]."""
    SHIFT_RANGE = 0.15
    """How far the middle of the rope is off the point nearest to the post at most [m]."""

    WINDING_LIMIT = 0.95
    """Success: smallest winding number, of either sign."""
    ENDS_LIMIT = 0.05
    """Success: largest distance of the rope's ends [m]."""

    # Half for being done: a rope pulled tight half around must earn clearly less than a closed one.
    WINDING_WEIGHT = 0.2
    """Share of the reward for winding."""
    CLOSING_WEIGHT = 0.3
    """Share of the reward for ends that come together around the post."""
    CLOSING_SCALE = 0.2
    """Distance of the ends [m] at which that share has fallen to a quarter."""
    SUCCESS_WEIGHT = 0.5
    """Share of the reward for success."""

    def __init__(
        self, *, resolution: int | Sequence[int] = 41, shapes: str | Sequence[str] = "cylinder", **settings: Any
    ) -> None:
        """Set up the task.

        Args:
            resolution: Number of nodes of the rope, 20 to 200; of several, each episode draws one.
            shapes: Shape of the post, "cylinder", "box" or "prism"; of several, each episode draws one.
            settings: Options of `DeformableEnv`; `num_grippers` is 2.

        Raises:
            ValueError: If an option has a value that is not allowed; says which are.
        """
        self.resolutions = check_resolutions(resolution, *RESOLUTIONS)
        self.shapes = _check_shapes(shapes)
        super().__init__(**settings)

    # ------------------------------------------------------------------ episode

    def build_models(self) -> list[Model]:
        """Build a straight rope of each resolution."""
        half = ROPE_LENGTH / 2
        return [rope([[-half, 0.0], [half, 0.0]], num_nodes=num) for num in self.resolutions]

    def build_colliders(self) -> list[Collider]:
        """Build a post of each shape; one stands in each world."""
        return [POSTS[shape].collider for shape in self.shapes]

    def candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        """Return the ends."""
        return model.node_sets["ends"]

    def allocate_episode(self) -> None:
        """Create tables of ropes and posts."""
        is_shape = np.array([[name == shape for name in POSTS] for shape in self.shapes], np.float32)
        self._is_shape = torch.as_tensor(is_shape, device=self.device)
        self._along = self.node_table([model.rest_positions[:, 0] for model in self.models])
        self._end_nodes = self.variant_table([self.candidate_gripper_nodes(model) for model in self.models])

    def start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Stand a post on the table, and lay the rope beside it."""
        variant = self.variants[worlds]
        shape = self.draw_choice(worlds, len(self.shapes))
        centre, yaws, passing = self.draw_uniform(worlds, 2, 2, 2)
        centre = centre * (self.CENTRE_RANGE * self.pose_share)
        yaws = yaws * (self.YAW_RANGE * self.pose_share)
        self._place_posts(worlds, shape, centre, yaws[:, 0])
        return self._lay_down(self._along[variant], centre, yaws[:, 1], passing), self._end_nodes[variant]

    def _place_posts(self, worlds: torch.Tensor, shape: torch.Tensor, centre: torch.Tensor, yaw: torch.Tensor) -> None:
        """Stand posts of given shapes (b,) on the table at (b, 2) [m], turned by (b,) [rad]; the other shapes are not there."""
        solver, zero = self.solver, torch.zeros_like(yaw)
        solver.collider_positions[worlds] = torch.nn.functional.pad(centre, (0, 1), value=POST_HEIGHT / 2)[:, None]
        solver.collider_rotations[worlds] = torch.stack([(yaw / 2).cos(), zero, zero, (yaw / 2).sin()], dim=1)[:, None]
        solver.collider_active[worlds] = torch.arange(len(self.shapes), device=self.device) == shape[:, None]

    def _lay_down(self, along: torch.Tensor, post: torch.Tensor, yaw: torch.Tensor, draws: torch.Tensor) -> torch.Tensor:
        """Lay straight ropes on the table, past posts at (b, 2) [m].

        Args:
            along: Places of the nodes along the rope, 0 in its middle, (b, N) [m].
            post: Positions of the posts, (b, 2) [m].
            yaw: Directions of the ropes, (b,) [rad].
            draws: In [-1, 1), (b, 2): the side of the post and the distance from it, and the shift along the rope.
        """
        near, far = self.PASSING_RANGE
        side = torch.where(draws[:, 0] < 0.0, -1.0, 1.0)
        aside = side * near + draws[:, 0] * ((far - near) * self.pose_share)
        along = along + draws[:, 1, None] * (self.SHIFT_RANGE * self.pose_share)
        direction = torch.stack([yaw.cos(), yaw.sin()], dim=-1)
        normal = torch.stack([-yaw.sin(), yaw.cos()], dim=-1)
        foot = post + aside[:, None] * normal
        return torch.nn.functional.pad(
            foot[:, None] + along[..., None] * direction[:, None], (0, 1), value=self.solver.model.radius
        )

    # ------------------------------------------------------------------ one control step

    @property
    def post_rotation(self) -> torch.Tensor:
        """Rotation of each post, (B, 3, 3); its columns are the axes of the post's frame, the last one that of the post."""
        return quaternion_to_matrix(self.solver.collider_rotations[:, 0])

    def in_post_frame(self, points: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
        """Return points (B, n, 3) [m] in the frame of the post: from the middle of its base, z along its axis."""
        base = self.solver.collider_positions[:, 0] - POST_HEIGHT / 2 * rotation[:, :, 2]
        return (points - base[:, None]) @ rotation

    def signed_winding(self, rotation: torch.Tensor) -> torch.Tensor:
        """Return the winding number of the rope about the post, (B,), positive if counter-clockwise from its first node on."""
        return winding_number(self.in_post_frame(self.solver.positions, rotation)[..., :2], self.solver.node_mask)

    @property
    def _shape_of_worlds(self) -> torch.Tensor:
        """Index of the shape of each post in `shapes`, (B,) int64."""
        return self.solver.collider_active.long().argmax(dim=1)

    def measure(self) -> WrappingMeasurement:
        """Measure how far the rope is closed around the post."""
        solver, rotation = self.solver, self.post_rotation
        rope = self.in_post_frame(solver.positions, rotation)
        winding = winding_number(rope[..., :2], solver.node_mask).abs()
        ends = self._end_nodes[self.variants]
        first, last = solver.positions.gather(1, ends[..., None].expand(-1, -1, 3)).unbind(1)
        gap = torch.linalg.vector_norm(last - first, dim=-1)
        is_at_height = (rope[..., 2] >= 0.0) & (rope[..., 2] <= POST_HEIGHT)
        is_closed = (winding >= self.WINDING_LIMIT) & (gap <= self.ENDS_LIMIT)
        share_at_height = mean_over_nodes(is_at_height, solver.node_mask)
        return WrappingMeasurement(
            success=is_closed & (is_at_height | ~solver.node_mask).all(dim=1),
            metrics={"winding": winding, "ends_distance": gap, "share_at_height": share_at_height},
            post_rotation=rotation,
            rope=rope,
        )

    def reward(self, measurement: WrappingMeasurement) -> torch.Tensor:
        """Return rewards in [0, 1], (B,); 1 for a closed rope whose ends touch.

        Ends that come together count as far as the rope winds around the post, and winding as far as it is at the post's height.
        """
        metrics = measurement.metrics
        winding = metrics["winding"].clamp(max=1.0) * metrics["share_at_height"]
        closing = winding.square() * (1.0 - torch.tanh(metrics["ends_distance"].double() / self.CLOSING_SCALE).float())
        return self.WINDING_WEIGHT * winding + self.CLOSING_WEIGHT * closing + self.SUCCESS_WEIGHT * measurement.success

    def object_values(self, measurement: WrappingMeasurement) -> dict[str, torch.Tensor]:
        """Return where the post is, seen from the nodes."""
        return self._post_values(measurement.rope, measurement.post_rotation)

    def gripper_values(self, measurement: WrappingMeasurement) -> dict[str, torch.Tensor]:
        """Return where the post and the other gripper are, seen from the grippers, and how far the rope winds."""
        grippers, rotation = self.solver.gripper_positions, measurement.post_rotation
        offsets = grippers.flip(1) - grippers
        return self._post_values(self.in_post_frame(grippers, rotation), rotation) | {
            "partner_offset": offsets,
            "partner_distance": torch.linalg.vector_norm(offsets, dim=-1),
            "winding": measurement.metrics["winding"][:, None].expand(-1, 2),
        }

    def _post_values(self, local: torch.Tensor, rotation: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the channels of the post at points (B, n, 3) of its frame, whose axes are the columns of (B, 3, 3)."""
        is_shape = self._is_shape[self._shape_of_worlds, :, None].expand(-1, -1, local.shape[1])
        return {
            "post_axis": rotation[:, None, :, 2].expand_as(local),
            "post_offset": -local[..., :2] @ rotation[:, :, :2].mT,
            "post_distance": torch.linalg.vector_norm(local[..., :2], dim=-1),
            "post_height": local[..., 2],
        } | {f"post_is_{name}": is_shape[:, index] for index, name in enumerate(POSTS)}

    def goal_observations(self) -> dict[str, torch.Tensor]:
        """Return the pose of the post and its shape."""
        pose = torch.cat([self.solver.collider_positions[:, 0], self.solver.collider_rotations[:, 0]], dim=1)
        return {"post_pose": pose, "post_shape": self._is_shape[self._shape_of_worlds]}


def _check_shapes(shapes: str | Sequence[str]) -> tuple[str, ...]:
    names = (shapes,) if isinstance(shapes, str) else tuple(shapes)
    unknown = [name for name in names if name not in POSTS]
    if unknown or not names or len(set(names)) < len(names):
        raise ValueError(f"shapes of the post must be different ones among {', '.join(POSTS)}, got {list(names)}")
    return names
