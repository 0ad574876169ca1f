"""Pictures of a world by SAPIEN."""

from __future__ import annotations

import numpy as np
import sapien
from mani_skill.utils.building.actor_builder import ActorBuilder

from maniskill_grpd.tasks.batched_scene import BatchedScene
from maniskill_grpd.tasks.drawing import Drawing

TABLE_HALF_SIZE = (0.8, 0.8, 0.02)
TABLE_COLOR = (0.62, 0.60, 0.56, 1.0)
ROPE_COLOR = (0.85, 0.38, 0.10, 1.0)
GRIPPER_COLOR = (0.12, 0.25, 0.65, 1.0)
GOAL_COLOR = (0.15, 0.40, 0.95, 0.45)
SOLVED_COLOR = (0.10, 0.75, 0.25, 0.60)
GRIPPER_SIZE = 1.8
"""Radius of the gripper balls in radii of the rope."""
GOAL_THICKNESS = 1.4
"""Radius of the goal in radii of the rope: it can be seen around a rope that lies in it."""
OUT_OF_SIGHT = np.array([0.0, 0.0, -50.0])
"""Where the goal is put when it is not to be seen [m]."""


class SapienPainter:
    """Mirrors one world on the SAPIEN stage of a scene.

    Rope and goal are chains of capsules, the goal translucent; grippers are balls; table at z = 0.
    """

    def __init__(self, scene: BatchedScene) -> None:
        """Build everything for a scene that can render; `show` moves it into place."""
        self._scene = scene
        model, num_grippers = scene.solver.model, scene.solver.num_grippers
        num_nodes, radius = model.num_nodes, model.radius
        half_length = float(model.rest_lengths.mean()) / 2.0
        rope, grippers = _material(ROPE_COLOR), _material(GRIPPER_COLOR)
        self._goal_material = _material(GOAL_COLOR)
        self._build_table()
        self._rope = self._build("rope", num_nodes - 1, radius, half_length, rope)
        goal_radius = GOAL_THICKNESS * radius
        self._goal = self._build(
            "goal", num_nodes - 1, goal_radius, half_length, self._goal_material
        )
        self._grippers = self._build("gripper", num_grippers, GRIPPER_SIZE * radius, 0.0, grippers)

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Move everything to where it is in a world; without the goal for what policies see."""
        _lay_chain(self._rope, drawing.object.points)
        _lay_chain(self._goal, drawing.goal.points + OUT_OF_SIGHT * hide_goal)
        for entity, position in zip(self._grippers, drawing.grippers, strict=True):
            entity.pose = sapien.Pose(position)
        self._goal_material.base_color = list(SOLVED_COLOR if drawing.is_solved else GOAL_COLOR)

    def _build_table(self) -> None:
        builder = self._scene.create_actor_builder()
        builder.add_box_visual(half_size=list(TABLE_HALF_SIZE), material=_material(TABLE_COLOR))
        self._finish(builder, "table", sapien.Pose([0.0, 0.0, -TABLE_HALF_SIZE[2]]))

    def _build(
        self,
        name: str,
        num: int,
        radius: float,
        half_length: float,
        material: sapien.render.RenderMaterial,
    ) -> list[sapien.Entity]:
        """Build capsules along their x-axis, or balls where `half_length` is 0."""
        entities = []
        for index in range(num):
            builder = self._scene.create_actor_builder()
            if half_length > 0.0:
                builder.add_capsule_visual(
                    radius=radius, half_length=half_length, material=material
                )
            else:
                builder.add_sphere_visual(radius=radius, material=material)
            entities.append(self._finish(builder, f"{name}_{index}", sapien.Pose()))
        return entities

    def _finish(self, builder: ActorBuilder, name: str, pose: sapien.Pose) -> sapien.Entity:
        builder.initial_pose = pose
        actor = builder.build_kinematic(name=name)
        # The stage is a mirror: it is no part of the state, and has a single copy for all worlds.
        self._scene.remove_from_state_dict_registry(actor)
        return actor._objs[0]


def _lay_chain(capsules: list[sapien.Entity], nodes: np.ndarray) -> None:
    """Lay capsules between consecutive nodes (N, 3)."""
    middles = (nodes[1:] + nodes[:-1]) / 2.0
    for capsule, middle, rotation in zip(
        capsules, middles, _rotations(np.diff(nodes, axis=0)), strict=True
    ):
        capsule.pose = sapien.Pose(middle, rotation)


def _rotations(directions: np.ndarray) -> np.ndarray:
    """Return the quaternions (w, x, y, z) that turn the x-axis into given directions, (n, 4)."""
    unit = directions / np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    # Half a turn about the middle of x-axis and direction; opposite to x any normal will do.
    quaternions = np.stack([1.0 + unit[:, 0], 0.0 * unit[:, 0], -unit[:, 2], unit[:, 1]], axis=1)
    quaternions[unit[:, 0] < -1.0 + 1e-6] = (0.0, 0.0, 0.0, 1.0)
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def _material(color: tuple[float, float, float, float]) -> sapien.render.RenderMaterial:
    return sapien.render.RenderMaterial(base_color=list(color), roughness=0.6, specular=0.3)
