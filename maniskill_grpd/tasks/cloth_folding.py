"""ClothFolding-v1: fold a cloth on a table along a given crease."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.registration import register_env

from maniskill_grpd.graphs import Channel
from maniskill_grpd.physics import Model, cloth
from maniskill_grpd.physics.mesh.outlines import check_polygon, signed_area
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.geometry.cloth_shapes import RESOLUTIONS, check_cloth_shapes, cloth_outline, in_cloth_frame
from maniskill_grpd.tasks.geometry.crease import (
    area_beyond,
    crease_ends,
    cut_open,
    hull_corners,
    mirror,
    offset_of_share,
    signed_distances,
)
from maniskill_grpd.tasks.geometry.fold_directions import CREASES, MOVING_SHARES, fold_directions
from maniskill_grpd.tasks.geometry.mesh_outlines import GivenMesh
from maniskill_grpd.tasks.geometry.shape_registry import GivenShape, Shape, shape_label
from maniskill_grpd.tasks.measurement import GoalMeasurement, Metric
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.observation.node_statistics import mean_over_nodes
from maniskill_grpd.tasks.options.resolutions import check_resolutions
from maniskill_grpd.tasks.pictures.drawing import Drawing, Line, Sheet
from maniskill_grpd.tasks.worlds.choices import as_choice

CLOTH_AREA = 0.0576
"""Area of the cloth [m^2]: a square of 24 cm."""
DEFAULT_RESOLUTIONS = {1: 225, 2: 100}
"""Number of nodes by the number of grippers. A corner folds across the rows of a square grid, whose cells hardly bend: coarse
ones keep the layers apart along such a crease."""

CREASE_NORMAL = Channel("crease_normal", "vector", "", "unit normal of the crease, towards the half that is to move, design")
IS_MOVING = Channel("is_moving", "scalar", "", "1 where the node belongs to the half that is to move, design")


@register_env("ClothFolding-v1", max_episode_steps=100)
class ClothFoldingEnv(DeformableEnv, BaseEnv):
    """
    **Task Description:**
    A cloth of 0.0576 m^2 (a square of 0.24 m by default) and 6 mm thickness lies flat on a table and must be folded along a given
    crease: the half beyond the crease must come to lie mirrored on top of the other half, which must stay where it is. Two
    floating grippers hold the two extreme points of the half that is to move, the ends of the side that is folded over; a single
    gripper holds its extreme point, a corner. The layers touch and rub: the moving half must be lifted over.

    **Randomizations:**
    - the centre of the cloth is uniform in the square [-0.15, 0.15] m x [-0.15, 0.15] m
    - its direction is uniform in [-180, 180] degrees
    - the crease is drawn in the frame of the cloth, independently of where that lies: with two grippers any side of the shape
      (of an L the four of its box, of a circle 48, of a star the lines from tip to tip; the long sides of a strip are left out,
      where more than half of it would move) is folded in, and the normal of the crease deviates from that of the side by
      an angle uniform in [-20, 20] degrees; with one gripper any corner is, and the angle to its bisector is uniform in
      [-10, 10] degrees
    - the half that is to move has a share of the area uniform in [0.25, 0.5]; where 0.25 would leave one of the held points out
      (slanted creases of triangles and rectangles), from the share at which the crease passes through that point
    - with `shapes=("square", "triangle", ...)` each episode draws one of the shapes, likewise with several resolutions
    - `pose_range="half"` and `"quarter"` shrink all ranges about their middle to a half and a quarter

    **Success Conditions:**
    - the mean distance of the moving half's nodes from their goals is at most 0.02 m
    - the mean distance of the resting half's nodes from where they lay at the start is less than 0.02 m

    **Fail Conditions:**
    - the simulation of the world has diverged; it stands still until it is reset

    **Goal Specification:**
    - the goal position of every node, (N, 3): for the moving half the mirror image across the crease, one thickness (6 mm) higher
      (also where it juts out over the table); for the resting half where it lay at the start
    - the unit normal of the crease, (3,), towards the moving half, and which nodes belong to that half, (N,)
    """  # noqa: D200, D205, D212, D400, D415  (the form of ManiSkill's task cards)

    GRIPPER_COUNTS = tuple(CREASES)
    DEFAULT_NUM_GRIPPERS = 2
    TRAINING = {"env_kwargs": ("resolution=225", "graph_nodes=25"), "num_envs": 16, "num_minibatches": 4, "gamma": 0.95}
    PROGRESS = Metric("fold_distance", "m")
    OBJECT_CHANNELS = (
        channels.VELOCITY,
        channels.GOAL_OFFSET,
        CREASE_NORMAL,
        channels.GOAL_DISTANCE,
        channels.CORNER,
        channels.HELD,
        channels.CONTACT,
        IS_MOVING,
    )
    RICH_GRIPPER_CHANNELS = (
        channels.VELOCITY,
        channels.GOAL_OFFSET,
        CREASE_NORMAL,
        channels.GOAL_DISTANCE,
        channels.CORNER,
        channels.GRIPPER_STATUS,
    )

    CAMERA_POSITION = (0.0, -0.5, 0.8)
    CAMERA_TARGET = (0.0, -0.03, 0.0)

    CENTRE_RANGE = 0.15
    """Largest coordinate of the centre of the cloth [m]."""
    YAW_RANGE = np.pi
    """Largest angle of the cloth about the vertical [rad]."""

    FOLD_DISTANCE_LIMIT = 0.02
    """Success: largest mean distance of the moving half from its mirror image [m]."""
    DRIFT_LIMIT = 0.02
    """Success: mean distance below which the resting half has stayed where it was [m]."""

    DRIFT_WEIGHT = 1.5
    """Weight of the drift of the resting half against the distance of the moving half. A cloth that is pushed across the table as
    a whole brings its moving half nearer to the goal, but never by more than it drifts: above 1, that does not pay."""
    FAR_WEIGHT = 0.2
    """Share of the reward that draws the moving half over from anywhere."""
    FAR_SCALE = 0.1
    """Weighted distance [m] at which that share has fallen to a quarter."""
    NEAR_WEIGHT = 0.3
    """Share of the reward for precision."""
    NEAR_SCALE = 0.03
    """Weighted distance [m] at which that share has fallen to 1 / e."""
    SUCCESS_WEIGHT = 0.5
    """Share of the reward for success."""

    def __init__(
        self,
        *,
        num_grippers: int | None = None,
        resolution: int | Sequence[int] | None = None,
        shapes: GivenShape | GivenMesh | Iterable[GivenShape | GivenMesh] = "square",
        holes: Sequence[np.ndarray] = (),
        **settings: Any,
    ) -> None:
        """Set up the task.

        Args:
            num_grippers: 2 (default) or 1.
            resolution: Number of nodes of the cloth, about, 49 to 1225; of several, each episode draws one. 100 by default with
                two grippers and 225 with one. Much coarser cloths are too stiff along slanted creases for some of the folds.
            shapes: The cloth's outline, a name ("square" by default, "rectangle", "triangle", "hexagon", "circle", with two
                grippers "l_shape", or one of `register_cloth_shape`) or a polygon (P, 2) [m], which keeps its size and with one
                gripper must be convex, or a flat mesh (a `trimesh.Trimesh`, or vertices and faces), whose rim counts; of
                several, each episode draws one.
            holes: Polygons (P, 2) [m] that are cut out of every cloth, in the coordinates of its outline.
            settings: Options of `DeformableEnv`.

        Raises:
            ValueError: If an option has a value that is not allowed; says which are.
        """
        if num_grippers is not None and num_grippers > max(CREASES):
            raise ValueError(
                f"num_grippers must be one of {list(CREASES)}, got {num_grippers}: a fold has two extreme points that move, and "
                "grippers on the resting half would pin down what has to stay by itself"
            )
        self.resolutions = None if resolution is None else check_resolutions(resolution, *RESOLUTIONS)
        self.shapes = check_cloth_shapes(shapes, CLOTH_AREA)
        self._holes = [check_polygon(hole, f"holes[{index}]") for index, hole in enumerate(holes)]
        super().__init__(num_grippers=num_grippers, **settings)

    # ------------------------------------------------------------------ episode

    def build_models(self) -> list[Model]:
        """Build a cloth of each shape and resolution."""
        self.resolutions = self.resolutions or (DEFAULT_RESOLUTIONS[self.num_grippers],)
        self._shape_of_variant = [shape for shape in self.shapes for _ in self.resolutions]
        sizes = self.resolutions * len(self.shapes)
        return [
            cloth(cloth_outline(shape, CLOTH_AREA), self._holes_of(shape), num_nodes=size)
            for shape, size in zip(self._shape_of_variant, sizes, strict=True)
        ]

    def _holes_of(self, shape: Shape) -> list[np.ndarray]:
        return [in_cloth_frame(shape, hole) for hole in self._holes]

    def candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        """Return the corners of the convex hull."""
        return hull_corners(model.rest_positions[:, :2])

    def allocate_episode(self) -> None:
        """Create goals and creases, and tables of cloths."""
        num_nodes = self.solver.num_nodes
        self.goal_positions = self.episode_tensor("goal_positions", num_nodes, 3, kind="position")
        self.is_moving = self.episode_tensor("is_moving", num_nodes, kind="scalar")
        self.crease_normal = self.episode_tensor("crease_normal", 3, kind="vector")
        self.crease_ends = self.episode_tensor("crease_ends", 2, 3, kind="position")
        shapes = self._shape_of_variant
        outlines = [cloth_outline(shape, CLOTH_AREA) for shape in shapes]
        regions = [cut_open(outline, self._holes_of(shape)) for outline, shape in zip(outlines, shapes, strict=True)]
        directions = [
            fold_directions(outline, self.num_grippers, shape_label(shape))
            for outline, shape in zip(outlines, shapes, strict=True)
        ]
        candidates = [self.candidate_gripper_nodes(model) for model in self.models]
        areas = [signed_area(region) for region in regions]
        self._areas = torch.tensor(areas, dtype=torch.float32, device=self.device)
        self._num_directions = torch.tensor([len(rows) for rows in directions], device=self.device)
        self._directions, self._outlines, self._regions, self._rest, self._candidates = (
            self.variant_table(tables)
            for tables in (directions, outlines, regions, [model.rest_positions[:, :2] for model in self.models], candidates)
        )

    def start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw a crease, lay the cloth on the table and the goal over it."""
        variant = self.variants[worlds]
        pose, direction, share = self.draw_uniform(worlds, 3, 2, 1)
        rest, radius = self._rest[variant], self.solver.model.radius
        normal = self._draw_normal(variant, direction)
        held = self._choose_start_nodes(variant, normal)
        offset = self._draw_offset(variant, normal, held, share[:, 0])
        beyond = (signed_distances(rest, normal, offset) > 0.0) & self.solver.node_mask[worlds]
        goal = torch.where(beyond[..., None], mirror(rest, normal, offset), rest)
        self.goal_positions[worlds] = self._lay_down(goal, radius + 2.0 * radius * beyond, pose)
        self.is_moving[worlds] = beyond.float()
        ends = crease_ends(self._outlines[variant], normal, offset)
        self.crease_ends[worlds] = self._lay_down(ends, ends.new_zeros(ends.shape[:2]), pose)
        origin = torch.zeros_like(pose[:, :2])  # a vector is laid down without being shifted
        turn = torch.cat([origin, pose[:, 2:]], dim=1)
        self.crease_normal[worlds] = self._lay_down(normal[:, None], normal.new_zeros(len(worlds), 1), turn)[:, 0]
        return self._lay_down(rest, rest.new_full(rest.shape[:2], radius), pose), held

    def _draw_normal(self, variant: torch.Tensor, draws: torch.Tensor) -> torch.Tensor:
        """Draw unit normals of creases in the frames of the cloths, (b, 2), from numbers in [-1, 1) (b, 2)."""
        direction = self._directions[variant, as_choice(draws[:, 0], self._num_directions[variant])]
        return _turn(direction[:, None], CREASES[self.num_grippers].deviation * self.pose_share * draws[:, 1])[:, 0]

    def _draw_offset(self, variant: torch.Tensor, normal: torch.Tensor, held: torch.Tensor, draws: torch.Tensor) -> torch.Tensor:
        """Draw offsets of creases (b,) [m], beyond which all held nodes (b, A) lie, from numbers in [-1, 1) (b,)."""
        regions, zero = self._regions[variant], torch.zeros_like(draws)
        points = self._rest[variant].gather(1, held[..., None].expand(-1, -1, 2))
        nearest = signed_distances(points, normal, zero).amin(dim=1)
        low, high = MOVING_SHARES
        low = (area_beyond(regions, normal, nearest) / self._areas[variant]).clamp(min=low)
        share = 0.5 * (low + high) + 0.5 * (high - low) * self.pose_share * draws
        return offset_of_share(regions, normal, share)

    def points_to_reach(self, worlds: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Return the goals of the nodes that are held."""
        return self.goal_positions[worlds].gather(1, nodes[..., None].expand(-1, -1, 3))[:, :, None]

    def _choose_start_nodes(self, variant: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
        """Return the extreme nodes that the grippers hold, (b, A)."""
        candidates = self._candidates[variant]
        points = self._rest[variant].gather(1, candidates[..., None].expand(-1, -1, 2))
        nodes = []
        for angle in CREASES[self.num_grippers].grip_angles:
            towards = _turn(normal[:, None], torch.full_like(normal[:, 0], angle))
            nodes.append(candidates.gather(1, (points * towards).sum(-1).argmax(dim=1, keepdim=True)))
        return torch.cat(nodes, dim=1)

    def _lay_down(self, points: torch.Tensor, heights: torch.Tensor, draws: torch.Tensor) -> torch.Tensor:
        """Lay points (b, n, 2) of the cloth's frame at heights (b, n) [m], at poses given by draws in [-1, 1) (b, 3)."""
        centre = draws[:, None, :2] * (self.CENTRE_RANGE * self.pose_share)
        turned = _turn(points, draws[:, 2] * (self.YAW_RANGE * self.pose_share))
        return torch.cat([turned + centre, heights[..., None]], dim=-1)

    # ------------------------------------------------------------------ one control step

    def measure(self) -> GoalMeasurement:
        """Measure how far the two halves are from their goals."""
        offsets = self.goal_positions - self.solver.positions
        distances = torch.linalg.vector_norm(offsets, dim=-1)
        is_moving = self.is_moving > 0.0
        fold_distance = mean_over_nodes(distances, is_moving)
        drift = mean_over_nodes(distances, self.solver.node_mask & ~is_moving)
        return GoalMeasurement(
            success=(fold_distance <= self.FOLD_DISTANCE_LIMIT) & (drift < self.DRIFT_LIMIT),
            metrics={"fold_distance": fold_distance, "drift": drift},
            goal_offsets=offsets,
            goal_distances=distances,
        )

    def reward(self, measurement: GoalMeasurement) -> torch.Tensor:
        """Return rewards in [0, 1], (B,); 1 where every node is at its goal."""
        distance = measurement.metrics["fold_distance"] + self.DRIFT_WEIGHT * measurement.metrics["drift"]
        far = 1.0 - torch.tanh(distance / self.FAR_SCALE)
        near = torch.exp(-((distance / self.NEAR_SCALE) ** 2))
        return self.FAR_WEIGHT * far + self.NEAR_WEIGHT * near + self.SUCCESS_WEIGHT * measurement.success

    def object_values(self, measurement: GoalMeasurement) -> dict[str, torch.Tensor]:
        """Return the way of each node to its goal, the crease, and which half the node belongs to."""
        return {
            "goal_offset": measurement.goal_offsets,
            "goal_distance": measurement.goal_distances,
            "crease_normal": self.crease_normal[:, None].expand_as(measurement.goal_offsets),
            "is_moving": self.is_moving,
        }

    def gripper_values(self, measurement: GoalMeasurement) -> dict[str, torch.Tensor]:
        """Return the ways of the nodes at which the grippers started, and the crease."""
        return {
            "goal_offset": self.at_start_nodes(measurement.goal_offsets),
            "goal_distance": self.at_start_nodes(measurement.goal_distances),
            "crease_normal": self.crease_normal[:, None].expand(-1, self.num_grippers, -1),
        }

    def goal_observations(self) -> dict[str, torch.Tensor]:
        """Return the goal position of every node, the crease and the half that is to move."""
        return {
            "goal_positions": self.goal_positions.flatten(1),
            "crease_normal": self.crease_normal,
            "is_moving": self.is_moving,
        }

    def drawing(self, world: int) -> Drawing:
        """Return the world with the mirrored half and the crease."""
        model = self.model_of(world)
        crease = self.crease_ends[world] + 2.0 * model.radius * self.solver.plane[world, :3]
        return replace(super().drawing(world), goal=self._draw_goal(world, model), lines=(Line(crease.cpu().numpy()),))

    def _draw_goal(self, world: int, model: Model) -> Sheet:
        """Return the mirrored half, up to the crease: nodes of triangles that the crease cuts are brought onto it."""
        goals, moving = self.goal_positions[world, : model.num_nodes], self.is_moving[world, : model.num_nodes] > 0.0
        normal, up = self.crease_normal[world], self.solver.plane[world, :3]
        short = ((self.crease_ends[world, 0] - goals) @ normal)[:, None]
        vertices = torch.where(moving[:, None], goals, goals + short * normal + 2.0 * model.radius * up)
        faces = model.faces[moving.cpu().numpy()[model.faces].any(axis=1)]
        return Sheet(vertices.cpu().numpy(), faces[:, ::-1])  # the mirror image is seen from behind


def _turn(points: torch.Tensor, angle: torch.Tensor) -> torch.Tensor:
    """Turn points (b, n, 2) counter-clockwise by angles (b,) [rad]."""
    cos, sin = angle.cos()[:, None], angle.sin()[:, None]
    x, y = points.unbind(-1)
    return torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1)
