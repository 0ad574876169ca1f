"""RopeWrapping-v1: close a rope around a post."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from mani_skill.utils.geometry.rotation_conversions import quaternion_apply
from mani_skill.utils.registration import register_env

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Collider, Model, rope
from maniskill_grpd.tasks import channels
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.drawing import Drawing, Solid, Tube
from maniskill_grpd.tasks.gripper_teams import gripper_teams
from maniskill_grpd.tasks.node_statistics import mean_over_nodes
from maniskill_grpd.tasks.post_leash import limit_around_post
from maniskill_grpd.tasks.posts import POST_HEIGHT, POSTS
from maniskill_grpd.tasks.resolutions import check_resolutions
from maniskill_grpd.tasks.winding import angles_between, arms_from_axis, turning_angles, winding_number

ROPE_LENGTH = 0.8
"""Length of the rope [m]."""
RESOLUTIONS = (20, 200)
"""Smallest and largest number of nodes."""

POST_CHANNELS = (
    Channel("post_axis", "vector", "", "unit vector from the base of the post to its top, design"),
    Channel("post_offset", "vector", "m", "nearest point of the post's axis minus position, design"),
    Channel("post_distance", "scalar", "m", "distance from the post's axis, design"),
    Channel("post_height", "scalar", "m", "height above the base of the post, along its axis, design"),
    *(Channel(f"post_is_{shape}", "scalar", "", f"1 where the post is a {shape}, design") for shape in POSTS),
)
PARTNER_OFFSET = Channel("partner_offset", "vector", "m", "position of the other gripper minus position, design")
PARTNER_DISTANCE = Channel("partner_distance", "scalar", "m", "distance of the other gripper, design")
WINDING = Channel("winding", "scalar", "", "|winding number| of the rope about the post, design")


@register_env("RopeWrapping-v1", max_episode_steps=100)
class RopeWrappingEnv(DeformableEnv):
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
    SUPPORTED_ROBOTS = gripper_teams(GRIPPER_COUNTS)
    OBJECT_CHANNELS = (
        channels.VELOCITY,
        *POST_CHANNELS,
        channels.ARC,
        channels.HELD,
        channels.CONTACT,
    )
    GRIPPER_CHANNELS = (
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
        self,
        *,
        resolution: int | Sequence[int] = 41,
        shapes: str | Sequence[str] = "cylinder",
        **settings: Any,
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

    def _build_models(self) -> list[Model]:
        half = ROPE_LENGTH / 2
        return [rope([[-half, 0.0], [half, 0.0]], num_nodes=num) for num in self.resolutions]

    def _build_colliders(self) -> list[Collider]:
        return [POSTS[shape].collider for shape in self.shapes]

    def _candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        return model.node_sets["ends"]

    def _allocate_episode(self) -> None:
        along = np.zeros((len(self.models), self.solver.num_nodes), np.float32)
        for index, model in enumerate(self.models):
            along[index, : model.num_nodes] = model.rest_positions[:, 0]
        ends = np.stack([self._candidate_gripper_nodes(model) for model in self.models])
        radii = [POSTS[shape].circumradius + self.solver.model.radius for shape in self.shapes]
        is_shape = [[float(name == shape) for name in POSTS] for shape in self.shapes]
        self._along, self._end_nodes = (torch.as_tensor(table, device=self.device) for table in (along, ends))
        self._taut_radii, self._is_shape = (torch.tensor(table, device=self.device) for table in (radii, is_shape))

    def _start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        variant = self.solver.variants[worlds].long()
        shape = self._draw_choice(worlds, len(self.shapes))
        draws = self._draw_uniform(worlds, 6)
        centre = draws[:, :2] * (self.CENTRE_RANGE * self._pose_share)
        yaws = draws[:, 2:4] * (self.YAW_RANGE * self._pose_share)
        self._place_posts(worlds, shape, centre, yaws[:, 0])
        return self._lay_down(self._along[variant], centre, yaws[:, 1], draws[:, 4:]), self._end_nodes[variant]

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
        aside = side * near + draws[:, 0] * ((far - near) * self._pose_share)
        along = along + draws[:, 1, None] * (self.SHIFT_RANGE * self._pose_share)
        direction = torch.stack([yaw.cos(), yaw.sin()], dim=-1)
        normal = torch.stack([-yaw.sin(), yaw.cos()], dim=-1)
        foot = post + aside[:, None] * normal
        return torch.nn.functional.pad(
            foot[:, None] + along[..., None] * direction[:, None], (0, 1), value=self.solver.model.radius
        )

    # ------------------------------------------------------------------ one control step

    @property
    def post_origin(self) -> torch.Tensor:
        """Middle of the post of each world, (B, 3) [m]."""
        return self.solver.collider_positions[:, 0]

    @property
    def post_axis(self) -> torch.Tensor:
        """Unit vector from the base to the top of each post, (B, 3)."""
        return quaternion_apply(self.solver.collider_rotations[:, 0], self.post_origin.new_tensor([0.0, 0.0, 1.0]))

    @property
    def winding(self) -> torch.Tensor:
        """Winding number of the rope about the post, positive if counter-clockwise from its first node to its last, (B,)."""
        arms = arms_from_axis(self.solver.positions, self.post_origin, self.post_axis)
        return winding_number(arms, self.solver.node_mask, self.post_axis)

    def _before_simulation_step(self) -> None:
        super()._before_simulation_step()
        self.solver.gripper_targets.copy_(self._reachable_targets())

    def _reachable_targets(self) -> torch.Tensor:
        """Draw gripper targets together so far that the rope reaches around the post, (B, 2, 3) [m].

        Not where the rope is above the post.
        """
        solver, origin, axis = self.solver, self.post_origin, self.post_axis
        arms = arms_from_axis(solver.positions, origin, axis)
        turned = torch.nn.functional.pad(turning_angles(arms, solver.node_mask, axis).cumsum(dim=1), (1, 0))
        turned = turned.gather(1, solver.gripper_nodes.long().clamp(min=0))
        starts, ends = (arms_from_axis(points, origin, axis) for points in (solver.gripper_positions, solver.gripper_targets))
        turned = turned + angles_between(starts, ends, axis)
        is_beside = (self._heights(solver.positions) <= POST_HEIGHT) & solver.node_mask
        length = torch.where(is_beside.any(dim=1), solver.leashes[:, 0, 1], torch.inf)
        radius = self._taut_radii[solver.collider_active.long().argmax(dim=1)]
        return limit_around_post(solver.gripper_targets, turned[:, 1] - turned[:, 0], length, radius, origin, axis)

    def _heights(self, points: torch.Tensor) -> torch.Tensor:
        """Return the heights of points (B, n, 3) above the base of the post, along its axis, (B, n) [m]."""
        return ((points - self.post_origin[:, None]) * self.post_axis[:, None]).sum(-1) + POST_HEIGHT / 2

    def evaluate(self) -> dict[str, torch.Tensor]:
        """Measure how far the rope is closed around the post; the observation reuses it."""
        mask = self.solver.node_mask
        ends = self._end_nodes[self.solver.variants.long()]
        first, last = self.solver.positions.gather(1, ends[..., None].expand(-1, -1, 3)).unbind(1)
        gap = torch.linalg.vector_norm(last - first, dim=-1)
        heights = self._heights(self.solver.positions)
        is_at_height = (heights >= 0.0) & (heights <= POST_HEIGHT)
        self._turns = winding = self.winding.abs()
        fail = self.solver.frozen.clone()
        is_closed = (winding >= self.WINDING_LIMIT) & (gap <= self.ENDS_LIMIT)
        return {
            "success": is_closed & (is_at_height | ~mask).all(dim=1) & ~fail,
            "fail": fail,
            "winding": winding,
            "ends_distance": gap,
            "share_at_height": mean_over_nodes(is_at_height, mask),
        }

    def compute_dense_reward(
        self,
        obs: Any,
        action: torch.Tensor,
        info: dict,
    ) -> torch.Tensor:
        """Return rewards in [0, 1], (B,); 1 for a closed rope whose ends touch, 0 after a failure.

        Ends that come together count as far as the rope winds around the post, and winding as far as it is at the post's height.
        """
        winding = info["winding"].clamp(max=1.0) * info["share_at_height"]
        closing = winding.square() * (1.0 - torch.tanh(info["ends_distance"] / self.CLOSING_SCALE))
        reward = self.WINDING_WEIGHT * winding + self.CLOSING_WEIGHT * closing + self.SUCCESS_WEIGHT * info["success"]
        return reward * ~info["fail"]

    def _object_values(self) -> dict[str, torch.Tensor]:
        return self._post_values(self.solver.positions)

    def _gripper_values(self) -> dict[str, torch.Tensor]:
        grippers = self.solver.gripper_positions
        offsets = grippers.flip(1) - grippers
        return self._post_values(grippers) | {
            "partner_offset": offsets,
            "partner_distance": torch.linalg.vector_norm(offsets, dim=-1),
            "winding": self._turns[:, None].expand(-1, 2),
        }

    def _post_values(self, points: torch.Tensor) -> dict[str, torch.Tensor]:
        """Return the channels of the post at points (B, n, 3)."""
        arms = arms_from_axis(points, self.post_origin, self.post_axis)
        is_shape = self._is_shape[self.solver.collider_active.long().argmax(dim=1)]
        return {
            "post_axis": self.post_axis[:, None].expand_as(points),
            "post_offset": -arms,
            "post_distance": torch.linalg.vector_norm(arms, dim=-1),
            "post_height": self._heights(points),
        } | {f"post_is_{name}": is_shape[:, index, None].expand(arms.shape[:2]) for index, name in enumerate(POSTS)}

    def _get_obs_extra(self, info: dict) -> dict[str, torch.Tensor]:
        obs = {"post_pose": torch.cat([self.post_origin, self.solver.collider_rotations[:, 0]], dim=1)}
        if self.obs_mode_struct.use_state:
            obs["rope_positions"] = self.solver.positions.flatten(1).clone()
            obs["rope_velocities"] = self.solver.velocities.flatten(1).clone()
        return obs

    def _drawing(self, world: int) -> Drawing:
        solver = self.solver
        return Drawing(
            object=Tube(self._nodes_of(world, solver.positions), solver.model.radius),
            solids=(self._solid(world),),
            grippers=solver.gripper_positions[world].cpu().numpy(),
            closed=solver.closed[world].cpu().numpy(),
            is_solved=bool(self.evaluate()["success"][world]),
        )

    def _solid(self, world: int) -> Solid:
        """Return the post of a world, where it stands."""
        vertices, faces = POSTS[self.shapes[int(self.solver.collider_active[world].long().argmax())]].solid()
        rotation = self.solver.collider_rotations[world, 0]
        local = torch.as_tensor(vertices, dtype=torch.float32, device=self.device)
        placed = quaternion_apply(rotation.expand(len(local), 4), local) + self.post_origin[world]
        return Solid(placed.cpu().numpy(), faces)


def _check_shapes(shapes: str | Sequence[str]) -> tuple[str, ...]:
    names = (shapes,) if isinstance(shapes, str) else tuple(shapes)
    unknown = [name for name in names if name not in POSTS]
    if unknown or not names or len(set(names)) < len(names):
        raise ValueError(f"shapes of the post must be different ones among {', '.join(POSTS)}, got {list(names)}")
    return names
