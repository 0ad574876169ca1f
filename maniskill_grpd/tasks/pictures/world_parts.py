"""Worlds of an environment as parts of a scene, side by side: what the browser and replays show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from maniskill_grpd.rendering import palette
from maniskill_grpd.tasks.pictures.drawing import Drawing, Line, Sheet, Solid, Tube
from maniskill_grpd.tasks.pictures.surfaces import (
    Surface,
    ghost_surface,
    gripper_shape,
    mark_surface,
    surface_of,
    table_lines,
    table_top,
    tube_surface,
)
from maniskill_grpd.viewer.parts import Copies, Look, Part, Shell, same_array

if TYPE_CHECKING:
    from maniskill_grpd.tasks.pictures.world_pictures import WorldPictures

SPACING = {True: 1.9, False: 2.4}
"""Distance of neighbouring worlds, with and without a table [m]."""
GHOST_OPACITY = 0.4
RIGID_TOLERANCE = 1e-4
"""Largest distance of a vertex of a solid from where a rigid motion takes it [m]; what is further is another solid."""
NOT_TURNED = (1.0, 0.0, 0.0, 0.0)


class WorldParts:
    """Parts of some worlds in a grid as square as possible, whose middle is the origin; a single world stands at its own place.

    What has not changed since the last call is the same object again, so that renderers need not look at it.

    Args:
        env: The environment.
        worlds: Which of its worlds.
    """

    def __init__(self, env: WorldPictures, worlds: Sequence[int]) -> None:
        self.env = env
        self.worlds = tuple(worlds)
        self.offsets = _grid(len(self.worlds), SPACING[env.HAS_TABLE])
        self._goals = [_Goal() for _ in self.worlds]
        self._solids: dict[str, tuple[Solid, Copies]] = {}
        self._table: dict[str, Part] = self._lay_table() if env.HAS_TABLE else {}
        self._joined: dict[str, tuple[tuple[int, ...], list[Surface], Shell]] = {}
        self._faces: tuple[tuple[int, ...], np.ndarray] = ((), np.zeros((0, 3), np.int64))

    def parts(self) -> dict[str, Part]:
        """Return what there is to see now, by names that stay."""
        drawings = [self.env.checked_drawing(world) for world in self.worlds]
        parts = {"object": self._object(drawings), **self._table, **self._grippers(drawings)}
        return parts | self._marks(drawings) | self._obstacles(drawings)

    def locate(self, point: np.ndarray) -> tuple[int, np.ndarray]:
        """Return the world whose cell of the grid a point (3,) of the scene is nearest to, and the point in its frame [m]."""
        cell = int(np.linalg.norm(self.offsets[:, :2] - point[:2], axis=1).argmin())
        return self.worlds[cell], np.asarray(point) - self.offsets[cell]

    def offset_of(self, world: int) -> np.ndarray:
        """Return where the origin of a world is in the scene, (3,) [m]."""
        return self.offsets[self.worlds.index(world)]

    @property
    def viewpoint(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Where somebody who sees all worlds stands and looks, (3,) each [m], and the vertical field of view [rad]."""
        position, target, fov = self.env.viewpoint
        farther = 1.0 + np.abs(self.offsets).max() / (np.linalg.norm(self.towards_viewer) * np.tan(fov / 2.0))
        return np.asarray(target) + farther * self.towards_viewer, np.asarray(target), fov

    @property
    def towards_viewer(self) -> np.ndarray:
        """From where the camera of the task looks to where it stands, (3,) [m]."""
        position, target, _ = self.env.viewpoint
        return np.subtract(position, target)

    def _object(self, drawings: list[Drawing]) -> Shell:
        meshes = [_mesh(drawing.object) for drawing in drawings]
        kinds = tuple(id(self.env.model_of(world)) for world in self.worlds)
        if kinds != self._faces[0]:
            self._faces = (kinds, _joined_faces(meshes))
        is_sheet = isinstance(drawings[0].object, Sheet)
        vertices = np.concatenate([mesh.vertices + offset for mesh, offset in zip(meshes, self.offsets, strict=True)])
        return Shell(vertices.astype(np.float32), self._faces[1], Look(palette.FRONT, palette.BACK if is_sheet else None))

    def _grippers(self, drawings: list[Drawing]) -> dict[str, Part]:
        positions = np.concatenate([d.grippers + offset for d, offset in zip(drawings, self.offsets, strict=True)])
        closed = np.concatenate([drawing.closed for drawing in drawings])
        kinds = (
            ("grippers/closed", True, closed, palette.CLOSED_GRIPPER),
            ("grippers/open", False, ~closed, palette.OPEN_GRIPPER),
        )
        return {
            name: _copies(gripper_shape(is_closed=is_closed), Look(color), positions[chosen])
            for name, is_closed, chosen, color in kinds
            if chosen.any()
        }

    def _marks(self, drawings: list[Drawing]) -> dict[str, Part]:
        """Return goals and marks, those of solved worlds in the colour of success."""
        found: dict[str, list[Surface]] = {}
        for goal, drawing, offset in zip(self._goals, drawings, self.offsets, strict=True):
            goal.update(drawing, offset)
            solved = "solved" if drawing.is_solved else "open"
            for kind, surface in (("goal", goal.ghost), ("marks", goal.marks)):
                if surface is not None:
                    found.setdefault(f"{kind}/{solved}", []).append(surface)
        colors = {"solved": palette.SOLVED, "open": palette.GOAL}
        opacities = {"goal": GHOST_OPACITY, "marks": 1.0}
        looks = {f"{kind}/{solved}": Look(colors[solved], None, opacities[kind]) for kind in opacities for solved in colors}
        return {name: self._join(name, surfaces, looks[name]) for name, surfaces in found.items()}

    def _join(self, name: str, surfaces: list[Surface], look: Look) -> Shell:
        key = tuple(map(id, surfaces))
        if name not in self._joined or self._joined[name][0] != key:
            vertices = np.concatenate([surface.vertices for surface in surfaces]).astype(np.float32)
            self._joined[name] = (key, surfaces, Shell(vertices, _joined_faces(surfaces), look))
        return self._joined[name][2]

    def _obstacles(self, drawings: list[Drawing]) -> dict[str, Part]:
        return {
            f"solids/{cell}/{index}": self._solid(f"solids/{cell}/{index}", solid, self.offsets[cell])
            for cell, drawing in enumerate(drawings)
            for index, solid in enumerate(drawing.solids)
        }

    def _solid(self, name: str, solid: Solid, offset: np.ndarray) -> Copies:
        """Return a solid as the mesh it was first seen as, and where that has moved to."""
        if name in self._solids:
            first, placed = self._solids[name]
            moved = _rigid_motion(first, solid, offset)
            if moved is not None:
                position, rotation = moved
                if not (same_array(position, placed.positions) and same_array(rotation, placed.rotations)):
                    placed = Copies(placed.vertices, placed.faces, placed.look, position, rotation)
                    self._solids[name] = (first, placed)
                return placed
        surface = surface_of(solid)
        placed = _copies(surface, Look(solid.color), offset[None])
        self._solids[name] = (solid, placed)
        return placed

    def _lay_table(self) -> dict[str, Part]:
        tops = (("table", table_top(), palette.TABLE), ("table/lines", table_lines(), palette.TABLE_LINES))
        return {name: _copies(surface, Look(color, is_backdrop=True), self.offsets) for name, surface, color in tops}


class _Goal:
    """Ghost and marks of one world, made anew only when the goal, a line or the success changes."""

    def __init__(self) -> None:
        self._seen: tuple[Any, ...] | None = None
        self.ghost: Surface | None = None
        self.marks: Surface | None = None

    def update(self, drawing: Drawing, offset: np.ndarray) -> None:
        """Follow a drawing."""
        seen = (*_content(drawing.goal), *(line.points for line in drawing.lines), np.array(drawing.is_solved))
        if self._seen is not None and len(seen) == len(self._seen) and all(map(same_array, seen, self._seen)):
            return
        self._seen = seen
        ghost, marks = ghost_surface(drawing), mark_surface(drawing)
        self.ghost = None if ghost is None else ghost.moved(offset)
        self.marks = marks.moved(offset) if len(marks.faces) else None


class _Placed(NamedTuple):
    position: np.ndarray
    rotation: np.ndarray


def _content(body: Tube | Sheet | Line | None) -> tuple[np.ndarray, ...]:
    if body is None:
        return ()
    return (body.vertices, body.faces) if isinstance(body, Sheet) else (body.points,)


def _copies(surface: Surface, look: Look, positions: np.ndarray) -> Copies:
    rotations = np.tile(np.float32(NOT_TURNED), (len(positions), 1))
    return Copies(surface.vertices.astype(np.float32), surface.faces, look, positions.astype(np.float32), rotations)


def _rigid_motion(first: Solid, now: Solid, offset: np.ndarray) -> _Placed | None:
    """Return where a solid has moved to, (1, 3) [m] and quaternion (1, 4); None where it is not the same solid."""
    if first.vertices.shape != now.vertices.shape or not same_array(first.faces, now.faces):
        return None
    if same_array(first.vertices, now.vertices):
        return _Placed(np.float32(offset)[None], np.float32(NOT_TURNED)[None])
    middle, moved = first.vertices.mean(axis=0), now.vertices.mean(axis=0)
    left, _, right = np.linalg.svd((now.vertices - moved).T @ (first.vertices - middle))
    turn = left @ np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))]) @ right
    shift = moved - turn @ middle
    if np.abs(first.vertices @ turn.T + shift - now.vertices).max() > RIGID_TOLERANCE:
        return None
    quaternion = Rotation.from_matrix(turn).as_quat()[[3, 0, 1, 2]]
    return _Placed(np.float32(shift + offset)[None], np.float32(quaternion)[None])


def _mesh(body: Tube | Sheet) -> Surface | Sheet:
    """Return the mesh of an object; a sheet is one."""
    return body if isinstance(body, Sheet) else tube_surface(body.points, body.radius)


def _joined_faces(surfaces: Iterable[Surface | Sheet]) -> np.ndarray:
    """Return the faces of several surfaces whose vertices follow each other."""
    faces, start = [], 0
    for surface in surfaces:
        faces.append(surface.faces + start)
        start += len(surface.vertices)
    return np.concatenate(faces)


def _grid(count: int, spacing: float) -> np.ndarray:
    """Return where the origins of worlds are, row by row from the far left, (count, 3) [m]."""
    columns = math.ceil(math.sqrt(count))
    rows = math.ceil(count / columns)
    cells = np.arange(count)
    x = (cells % columns - (columns - 1) / 2.0) * spacing
    y = ((rows - 1) / 2.0 - cells // columns) * spacing
    return np.stack([x, y, np.zeros(count)], axis=1)
