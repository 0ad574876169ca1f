"""Pictures of a world by SAPIEN."""

from __future__ import annotations

import numpy as np
import sapien
import trimesh

from maniskill_grpd.rendering import palette
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet, Solid
from maniskill_grpd.tasks.pictures.surfaces import (
    Surface,
    ghost_surface,
    gripper_surfaces,
    mark_surface,
    shadow_surface,
    solid_surface,
    surface_of,
    table_lines,
    table_top,
    turned_over,
)
from maniskill_grpd.tasks.worlds.batched_scene import BatchedScene

ROOM_SIZE = 8.0
"""Side of the bright cube around everything, for pictures that are not observations [m]."""
SIDE_DISTANCE = 0.001
"""Distance of the two sides of a sheet [m]."""
GHOST_ALPHA = 0.45


class SapienPainter:
    """Mirrors one world on the SAPIEN stage of a scene, in meshes that are built anew for each world shown. Table at z = 0.

    Shadows are meshes on the table, as SAPIEN would have ghosts cast them too.
    """

    def __init__(self, scene: BatchedScene) -> None:
        """Build the surroundings for a scene that can render; `show` builds the rest."""
        self._stage = scene.sub_scenes[0]
        self._table = _entity("table", [_shape(table_top(), palette.TABLE), _shape(table_lines(), palette.TABLE_LINES)])
        self._room = _entity("room", [_room_shape()])
        self._shown: list[sapien.Entity] = []

    def show(self, drawing: Drawing, *, hide_goal: bool = False) -> None:
        """Replace what is on the stage by a world; without goal and room for what policies see."""
        for entity in self._shown:
            self._stage.remove_entity(entity)
        parts = _opaque_parts(drawing)
        self._shown = [_entity(name, [_shape(*side) for side in sides]) for name, sides in parts.items() if sides]
        if drawing.has_table:
            shadows = [_shadow_shape(surface) for sides in parts.values() for surface, _ in sides]
            self._shown += [self._table, _entity("shadows", shadows)]
        if not hide_goal:
            self._shown += [self._room, _entity("goal", _goal_shapes(drawing))]
        for entity in self._shown:
            self._stage.add_entity(entity)


Side = tuple[Surface, palette.Color]


def _opaque_parts(drawing: Drawing) -> dict[str, list[Side]]:
    """Return surfaces of which the front is shown, and their colours, by what they belong to."""
    body, solids = surface_of(drawing.object), map(surface_of, drawing.solids)
    colors = [palette.CLOSED_GRIPPER if is_closed else palette.OPEN_GRIPPER for is_closed in drawing.closed]
    return {
        "object": _sheet_sides(body) if isinstance(drawing.object, Sheet) else [(body, palette.FRONT)],
        "obstacles": [(solid, palette.SOLID) for solid in solids],
        "grippers": list(zip(gripper_surfaces(drawing), colors, strict=True)),
    }


def _sheet_sides(sheet: Surface) -> list[Side]:
    """Return the two sides of a sheet, a hair apart."""
    offset = SIDE_DISTANCE / 2.0 * sheet.normals
    return [(sheet.moved(offset), palette.FRONT), (turned_over(sheet.moved(-offset)), palette.BACK)]


def _goal_shapes(drawing: Drawing) -> list[sapien.render.RenderShape]:
    color = palette.SOLVED if drawing.is_solved else palette.GOAL
    marks, ghost = mark_surface(drawing), ghost_surface(drawing)
    shapes = [_shape(marks, color)] if len(marks.faces) else []
    return shapes if ghost is None else [*shapes, _shape(ghost, color, GHOST_ALPHA)]


def _shadow_shape(surface: Surface) -> sapien.render.RenderShape:
    """Return the shadow of a surface, lit from above whichever way its triangles face."""
    shadow = shadow_surface(surface)
    corners = shadow.vertices[shadow.faces]
    is_down = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] < 0.0
    faces = np.where(is_down[:, None], shadow.faces[:, ::-1], shadow.faces)
    color = tuple((1.0 - palette.SHADOW_DARKNESS) * np.array(palette.TABLE))
    return _shape(Surface(shadow.vertices, faces, shadow.normals), color)


def _room_shape() -> sapien.render.RenderShape:
    """Return the inside of a cube that shines by itself."""
    cube = trimesh.creation.box(extents=[ROOM_SIZE] * 3)
    shape = _shape(turned_over(solid_surface(Solid(cube.vertices, cube.faces))), (0.0, 0.0, 0.0))
    shape.parts[0].material.emission = [*_linear(palette.BACKGROUND), 1.0]
    return shape


def _entity(name: str, shapes: list[sapien.render.RenderShape]) -> sapien.Entity:
    body = sapien.render.RenderBodyComponent()
    for shape in shapes:
        body.attach(shape)
    entity = sapien.Entity()
    entity.name = name
    entity.add_component(body)
    return entity


def _shape(surface: Surface, color: palette.Color, alpha: float = 1.0) -> sapien.render.RenderShape:
    material = sapien.render.RenderMaterial(base_color=[*_linear(color), alpha], roughness=0.6, specular=0.3)
    vertices = surface.vertices.astype(np.float32)
    return sapien.render.RenderShapeTriangleMesh(
        vertices,
        surface.faces.astype(np.uint32),
        surface.normals.astype(np.float32),
        np.zeros((len(vertices), 2), dtype=np.float32),
        material,
    )


def _linear(color: palette.Color) -> np.ndarray:
    """Return the light of an sRGB colour."""
    return np.asarray(color) ** 2.2
