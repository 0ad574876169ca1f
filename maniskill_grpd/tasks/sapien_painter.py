"""Pictures of a world by SAPIEN."""

from __future__ import annotations

import numpy as np
import sapien

from maniskill_grpd.tasks import palette
from maniskill_grpd.tasks.batched_scene import BatchedScene
from maniskill_grpd.tasks.drawing import Drawing
from maniskill_grpd.tasks.surfaces import (
    Surface,
    ghost_surface,
    gripper_surfaces,
    mark_surface,
    object_sides,
    surface_of,
    table_lines,
    table_top,
)

GHOST_ALPHA = 0.45


class SapienPainter:
    """Mirrors one world on the SAPIEN stage of a scene, in meshes that are built anew for each world shown. Table at z = 0."""

    def __init__(self, scene: BatchedScene) -> None:
        """Build the table of a scene that can render; `show` builds the rest."""
        self._stage = scene.sub_scenes[0]
        self._table = _entity("table", [_shape(table_top(), palette.TABLE), _shape(table_lines(), palette.TABLE_LINES)])
        self._shown: list[sapien.Entity] = []

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Replace what is on the stage by a world; without the goal for what policies see."""
        for entity in self._shown:
            self._stage.remove_entity(entity)
        shapes = {
            "object": [_shape(surface, color) for surface, color in object_sides(drawing.object)],
            "obstacles": [_shape(surface_of(solid), palette.SOLID) for solid in drawing.solids],
            "grippers": [
                _shape(surface, palette.CLOSED_GRIPPER if is_closed else palette.OPEN_GRIPPER)
                for surface, is_closed in zip(gripper_surfaces(drawing), drawing.closed, strict=True)
            ],
            "goal": [] if hide_goal else self._goal_shapes(drawing),
        }
        self._shown = [_entity(name, parts) for name, parts in shapes.items() if parts]
        if drawing.has_table:
            self._shown.append(self._table)
        for entity in self._shown:
            self._stage.add_entity(entity)

    def _goal_shapes(self, drawing: Drawing) -> list[sapien.render.RenderShape]:
        color = palette.SOLVED if drawing.is_solved else palette.GOAL
        marks = mark_surface(drawing)
        shapes = [_shape(marks, color)] if len(marks.faces) else []
        if drawing.goal is not None:
            shapes.append(_shape(ghost_surface(drawing.goal), color, GHOST_ALPHA))
        return shapes


def _entity(name: str, shapes: list[sapien.render.RenderShape]) -> sapien.Entity:
    body = sapien.render.RenderBodyComponent()
    for shape in shapes:
        body.attach(shape)
    entity = sapien.Entity()
    entity.name = name
    entity.add_component(body)
    return entity


def _shape(surface: Surface, color: tuple[float, float, float], alpha: float = 1.0) -> sapien.render.RenderShape:
    material = sapien.render.RenderMaterial(base_color=[*_linear(color), alpha], roughness=0.6, specular=0.3)
    vertices = surface.vertices.astype(np.float32)
    return sapien.render.RenderShapeTriangleMesh(
        vertices,
        surface.faces.astype(np.uint32),
        surface.normals.astype(np.float32),
        np.zeros((len(vertices), 2), dtype=np.float32),
        material,
    )


def _linear(color: tuple[float, float, float]) -> np.ndarray:
    """Return the light of an sRGB colour."""
    return np.asarray(color) ** 2.2
