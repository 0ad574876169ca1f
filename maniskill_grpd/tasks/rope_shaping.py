"""RopeShaping-v1: bring a rope on a table into a given planar shape."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.registration import register_env

from maniskill_grpd.physics import Model, rope
from maniskill_grpd.tasks.deformable_env import DeformableEnv
from maniskill_grpd.tasks.geometry.goal_shapes import GOAL_SHAPES, goal_curve
from maniskill_grpd.tasks.geometry.shape_registry import GivenShape
from maniskill_grpd.tasks.measurement import GoalMeasurement, Metric
from maniskill_grpd.tasks.observation import channels
from maniskill_grpd.tasks.observation.node_statistics import max_over_nodes, mean_over_nodes
from maniskill_grpd.tasks.options.resolutions import check_resolutions
from maniskill_grpd.tasks.pictures.drawing import Drawing, Tube
from maniskill_grpd.tasks.worlds.choices import as_choice

ROPE_LENGTH = 0.8
"""Length of the rope [m]."""
RESOLUTIONS = (20, 200)
"""Smallest and largest number of nodes."""
GRAPH_NODES = 21
"""Number of nodes in the graph of a rope that has more, unless another is asked for."""
GRIPPER_ARCS = {2: (0.0, 1.0), 3: (0.0, 0.5, 1.0), 4: (0.0, 0.25, 0.75, 1.0)}
"""Arc fractions at which the grippers hold the rope, by their number."""


@register_env("RopeShaping-v1", max_episode_steps=100)
class RopeShapingEnv(DeformableEnv, BaseEnv):
    """
    **Task Description:**
    A rope of 0.8 m lies straight on a table and must take a given planar shape, "W" by default, at
    a given place. Four floating grippers (optionally two or three) hold it at fixed points: at 0,
    1/4, 3/4 and 1 of its length (the ends; the ends and the middle). What hangs between them must
    be laid by dragging it.

    **Randomizations:**
    - the centre of the rope is uniform in the square [-0.15, 0.15] m x [-0.15, 0.15] m
    - its direction is uniform in [-180, 180] degrees
    - the centre and the direction of the goal are drawn from the same ranges, independently
    - with `shapes=("W", "S", ...)` each episode draws one of the shapes
    - `pose_range="half"` and `"quarter"` shrink all four ranges to a half and a quarter

    **Success Conditions:**
    - the mean distance of the rope's nodes from their goals is at most 0.03 m
    - the largest of these distances is at most 0.08 m

    **Fail Conditions:**
    - the simulation of the world has diverged; it stands still until it is reset

    **Goal Specification:**
    - the goal position of every node, (N, 3): a curve of exactly the rope's length (W, V, U, S, L,
      O or spiral) on the table
    """  # noqa: D200, D205, D212, D400, D415  (the form of ManiSkill's task cards)

    GRIPPER_COUNTS = tuple(GRIPPER_ARCS)
    DEFAULT_NUM_GRIPPERS = 4
    TRAINING = {"num_envs": 16, "num_minibatches": 4}
    PROGRESS = Metric("mean_distance", "m")
    OBJECT_CHANNELS = (
        channels.VELOCITY,
        channels.GOAL_OFFSET,
        channels.GOAL_DISTANCE,
        channels.ARC,
        channels.HELD,
        channels.CONTACT,
    )
    RICH_GRIPPER_CHANNELS = (
        channels.VELOCITY,
        channels.GOAL_OFFSET,
        channels.GOAL_DISTANCE,
        channels.ARC,
        channels.GRIPPER_STATUS,
    )

    CENTRE_RANGE = 0.15
    """Largest coordinate of the centres of rope and goal [m]."""
    YAW_RANGE = np.pi
    """Largest angle of rope and goal about the vertical [rad]."""

    MEAN_DISTANCE_LIMIT = 0.03
    """Success: largest mean distance of the nodes from their goals [m]."""
    MAX_DISTANCE_LIMIT = 0.08
    """Success: largest distance of any node from its goal [m]."""

    # Return must rise with every bit of the detour that lays the free part of the rope, also where success is still far
    # (docs/decisions.md).
    FAR_WEIGHT = 0.1
    """Share of the reward that draws the rope near from anywhere."""
    FAR_SCALE = 0.2
    """Mean distance [m] at which that share has fallen to a quarter."""
    NEAR_WEIGHT = 0.6
    """Share of the reward for precision."""
    NEAR_SCALE = 0.05
    """Mean distance [m] at which that share has fallen to 1 / e."""
    SUCCESS_WEIGHT = 0.3
    """Share of the reward for success."""

    def __init__(
        self,
        *,
        resolution: int | Sequence[int] = 41,
        goal_shape: GivenShape = "W",
        shapes: Iterable[GivenShape] | None = None,
        graph_nodes: int | None = GRAPH_NODES,
        **settings: Any,
    ) -> None:
        """Set up the task.

        Args:
            resolution: Number of nodes of the rope, 20 to 200; of several, each episode draws one.
            goal_shape: The goal, a name ("W" by default, "V", "U", "S", "L", "O", "spiral", or one of
                `register_goal_shape`) or an open curve (P, 2), which is scaled to the rope's length.
            shapes: Several of these, from which each episode draws one; instead of `goal_shape`.
            graph_nodes: Number of nodes in the graph, 21 by default and None for all. Policies that
                see every other node of the default rope learn in less time and no worse
                (docs/results/earlier/rope_shaping.md).
            settings: Options of `DeformableEnv`; `num_grippers` is 2, 3 or 4 (default).

        Raises:
            ValueError: If an option has a value that is not allowed; says which are.
        """
        self.resolutions = check_resolutions(resolution, *RESOLUTIONS)
        self.shapes = GOAL_SHAPES.parse(*((goal_shape, "goal_shape") if shapes is None else (shapes, "shapes")))
        if graph_nodes == GRAPH_NODES:
            graph_nodes = min(graph_nodes, *self.resolutions)  # the default suits shorter ropes too
        super().__init__(graph_nodes=graph_nodes, **settings)

    # ------------------------------------------------------------------ episode

    def build_models(self) -> list[Model]:
        """Build a straight rope of each resolution."""
        half = ROPE_LENGTH / 2
        return [rope([[-half, 0.0], [half, 0.0]], num_nodes=num) for num in self.resolutions]

    def candidate_gripper_nodes(self, model: Model) -> np.ndarray:
        """Return the nodes at `GRIPPER_ARCS`."""
        fractions = np.array(GRIPPER_ARCS[self.num_grippers])
        return np.rint(fractions * (model.num_nodes - 1)).astype(np.int64)

    def allocate_episode(self) -> None:
        """Create the goals, and tables of ropes and goal curves."""
        self.goal_positions = self.episode_tensor("goal_positions", self.solver.num_nodes, 3, kind="position")
        curves = [
            np.stack([goal_curve(shape, model.length, model.num_nodes) for shape in self.shapes], axis=1) for model in self.models
        ]
        self._straight = self.node_table([model.rest_positions[:, :2] for model in self.models])
        self._goal_curves = self.node_table(curves).transpose(1, 2)
        self._held_nodes = self.variant_table([self.candidate_gripper_nodes(model) for model in self.models])

    def start_episode(self, worlds: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Lay rope and goal on the table."""
        variant = self.variants[worlds]
        start, goal, shape = self.draw_uniform(worlds, 3, 3, 1)
        curves = self._goal_curves[variant, as_choice(shape[:, 0], len(self.shapes))]
        self.goal_positions[worlds] = self._lay_down(curves, goal)
        return self._lay_down(self._straight[variant], start), self._held_nodes[variant]

    def points_to_reach(self, worlds: torch.Tensor, nodes: torch.Tensor) -> torch.Tensor:
        """Return the goals of the nodes that are held."""
        return self.goal_positions[worlds].gather(1, nodes[..., None].expand(-1, -1, 3))[:, :, None]

    def _lay_down(self, curves: torch.Tensor, draws: torch.Tensor) -> torch.Tensor:
        """Lay planar curves (b, N, 2) on the table, at poses given by draws in [-1, 1) (b, 3)."""
        yaw = draws[:, 2, None] * (self.YAW_RANGE * self.pose_share)
        centre = draws[:, None, :2] * (self.CENTRE_RANGE * self.pose_share)
        x, y = curves.unbind(-1)
        cos, sin = yaw.cos(), yaw.sin()
        turned = torch.stack([cos * x - sin * y, sin * x + cos * y], dim=-1) + centre
        return torch.nn.functional.pad(turned, (0, 1), value=self.solver.model.radius)

    # ------------------------------------------------------------------ one control step

    def measure(self) -> GoalMeasurement:
        """Measure how far the nodes are from their goals."""
        offsets = self.goal_positions - self.solver.positions
        distances = torch.linalg.vector_norm(offsets, dim=-1)
        mean = mean_over_nodes(distances, self.solver.node_mask)
        largest = max_over_nodes(distances, self.solver.node_mask)
        return GoalMeasurement(
            success=(mean <= self.MEAN_DISTANCE_LIMIT) & (largest <= self.MAX_DISTANCE_LIMIT),
            metrics={"mean_distance": mean, "max_distance": largest},
            goal_offsets=offsets,
            goal_distances=distances,
        )

    def reward(self, measurement: GoalMeasurement) -> torch.Tensor:
        """Return rewards in [0, 1], (B,); 1 where every node is at its goal."""
        distance = measurement.metrics["mean_distance"]
        far = 1.0 - torch.tanh(distance / self.FAR_SCALE)
        near = torch.exp(-((distance / self.NEAR_SCALE) ** 2))
        return self.FAR_WEIGHT * far + self.NEAR_WEIGHT * near + self.SUCCESS_WEIGHT * measurement.success

    def object_values(self, measurement: GoalMeasurement) -> dict[str, torch.Tensor]:
        """Return the way of each node to its goal."""
        return {"goal_offset": measurement.goal_offsets, "goal_distance": measurement.goal_distances}

    def gripper_values(self, measurement: GoalMeasurement) -> dict[str, torch.Tensor]:
        """Return the ways of the nodes at which the grippers started."""
        return {name: self.at_start_nodes(values) for name, values in self.object_values(measurement).items()}

    def goal_observations(self) -> dict[str, torch.Tensor]:
        """Return the goal position of every node."""
        return {"goal_positions": self.goal_positions.flatten(1)}

    def drawing(self, world: int) -> Drawing:
        """Return the world with the goal curve."""
        goal = Tube(self.nodes_of(world, self.goal_positions), self.solver.model.radius)
        return replace(super().drawing(world), goal=goal)
