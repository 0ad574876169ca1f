"""Triangle meshes of what a drawing shows, for both painters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh

from maniskill_grpd.rendering import palette
from maniskill_grpd.rendering.bodies import JAW_OPENING, JAW_RADIUS, TABLE_HALF_SIZE
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet, Solid, Tube

TUBE_SIDES = 12
CAP_RINGS = 3
"""Rings of vertices of the round ends of tubes."""
CREASE_ANGLE = np.deg2rad(35.0)
"""Faces of solids that meet at a smaller angle are shaded as one smooth surface [rad]."""
GHOST_THICKNESS = 1.45
"""Radius of the ghost of a rope in radii of the rope."""
MARK_RADIUS = 0.0025
"""Half the thickness of outlines and lines [m]."""
DASH_LENGTH = 0.02
TILE_SIZE = 0.1
"""Distance of the lines on the table [m]."""
TABLE_LINE_WIDTH = 0.003
LINE_HEIGHT, SHADOW_HEIGHT = 0.0003, 0.0006
"""Where lines and shadows lie above the table [m]: far enough to be told apart."""


@dataclass(frozen=True)
class Surface:
    """A shaded triangle mesh."""

    vertices: np.ndarray
    """(n, 3) [m]."""
    faces: np.ndarray
    """(F, 3), counter-clockwise as seen from the front."""
    normals: np.ndarray
    """Unit normals of the front at the vertices, (n, 3)."""

    def moved(self, offset: np.ndarray) -> Surface:
        """Return the surface moved by an offset, (3,) or one for each vertex (n, 3) [m]."""
        return Surface(self.vertices + offset, self.faces, self.normals)


def surface_of(body: Tube | Sheet | Solid) -> Surface:
    """Return the surface of something."""
    if isinstance(body, Tube):
        return tube_surface(body.points, body.radius)
    return sheet_surface(body) if isinstance(body, Sheet) else solid_surface(body)


def turned_over(surface: Surface) -> Surface:
    """Return a surface with front and back exchanged."""
    return Surface(surface.vertices, surface.faces[:, ::-1], -surface.normals)


def sheet_surface(sheet: Sheet) -> Surface:
    """Return a sheet with smooth normals, the means over the faces around each vertex."""
    vertices, faces = np.asarray(sheet.vertices, dtype=np.float64), np.asarray(sheet.faces)
    first, second, third = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], np.cross(second - first, third - first))
    return Surface(vertices, faces, _unit(normals))


def solid_surface(solid: Solid) -> Surface:
    """Return a solid with sharp edges where its faces meet at more than `CREASE_ANGLE`."""
    mesh = trimesh.Trimesh(solid.vertices, solid.faces, process=True)
    smooth = trimesh.graph.smooth_shade(mesh, angle=CREASE_ANGLE)
    return Surface(smooth.vertices.view(np.ndarray), smooth.faces.view(np.ndarray), smooth.vertex_normals.copy())


def tube_surface(points: np.ndarray, radius: float) -> Surface:
    """Return a tube with round ends about a polyline (n, 3) [m]."""
    points = np.asarray(points, dtype=np.float64)
    tangents = _unit(np.gradient(points, axis=0))
    sideways = _transported_normals(tangents)
    angles = np.linspace(0.0, 2.0 * np.pi, TUBE_SIDES, endpoint=False)
    around = np.cos(angles)[:, None] * sideways[:, None] + np.sin(angles)[:, None] * np.cross(tangents, sideways)[:, None]
    # A cap is a quarter circle turned about the axis: rings that get smaller, with tilted normals.
    tilts = np.linspace(np.pi / 2.0, 0.0, CAP_RINGS, endpoint=False)
    tilts = np.concatenate([-tilts, np.zeros(len(points)), tilts[::-1]])
    knots = np.concatenate([np.zeros(CAP_RINGS, int), np.arange(len(points)), np.full(CAP_RINGS, len(points) - 1)])
    normals = np.cos(tilts)[:, None, None] * around[knots] + np.sin(tilts)[:, None, None] * tangents[knots][:, None]
    vertices = points[knots][:, None] + radius * normals
    return Surface(vertices.reshape(-1, 3), _grid_faces(len(knots)), normals.reshape(-1, 3))


def ghost_surface(drawing: Drawing) -> Surface | None:
    """Return the body of a goal, None where it has none.

    That of a rope is thicker than the rope, so that it can be seen around one. A cloth that lies where it should takes its place:
    two sheets in one place would show through each other in patches.
    """
    goal = drawing.goal
    if isinstance(goal, Tube):
        return tube_surface(goal.points, GHOST_THICKNESS * goal.radius)
    return None if goal is None or drawing.is_solved else sheet_surface(goal)


def mark_surface(drawing: Drawing) -> Surface:
    """Return the outline of a goal that is a sheet, holes included, and the dashes of all lines."""
    tubes = [tube_surface(dash, MARK_RADIUS) for line in drawing.lines for dash in dashes(line.points, DASH_LENGTH)]
    if isinstance(drawing.goal, Sheet):
        loops = boundary_loops(drawing.goal.faces)
        tubes += [tube_surface(drawing.goal.vertices[loop], MARK_RADIUS) for loop in loops]
    return _joined(tubes)


def shadow_surface(surface: Surface) -> Surface:
    """Return the shadow of a surface on the table, just above it, in triangles that may overlap and have no front."""
    light = palette.LIGHT_DIRECTION
    vertices = surface.vertices - surface.vertices[:, 2:].clip(0.0) * light / light[2]
    vertices[:, :2] = vertices[:, :2].clip(-TABLE_HALF_SIZE, TABLE_HALF_SIZE)
    vertices[:, 2] = SHADOW_HEIGHT
    return Surface(vertices, surface.faces, np.broadcast_to([0.0, 0.0, 1.0], vertices.shape))


def table_top() -> Surface:
    """Return the top of the table, in the plane z = 0."""
    return _flat_rectangles(np.array([[-1.0, -1.0, 1.0, 1.0]]) * TABLE_HALF_SIZE, 0.0)


def table_lines() -> Surface:
    """Return the lines on the table, just above it."""
    at = np.arange(-TABLE_HALF_SIZE, TABLE_HALF_SIZE + TILE_SIZE / 2.0, TILE_SIZE).clip(
        -TABLE_HALF_SIZE + TABLE_LINE_WIDTH / 2.0, TABLE_HALF_SIZE - TABLE_LINE_WIDTH / 2.0
    )
    full = np.full_like(at, TABLE_HALF_SIZE)
    low, high = at - TABLE_LINE_WIDTH / 2.0, at + TABLE_LINE_WIDTH / 2.0
    bounds = np.concatenate([np.stack([low, -full, high, full], 1), np.stack([-full, low, full, high], 1)])
    return _flat_rectangles(bounds, LINE_HEIGHT)


def boundary_loops(faces: np.ndarray) -> list[np.ndarray]:
    """Return the closed loops of edges that have a face on one side only, first vertex repeated at the end."""
    sides = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    present = set(map(tuple, sides.tolist()))
    following: dict[int, list[int]] = {}
    for start, end in sorted(present):
        if (end, start) not in present:
            following.setdefault(start, []).append(end)
    loops = []
    for start, ends in following.items():
        while ends:  # more than once where corners of two faces touch
            loop = [start, ends.pop()]
            while loop[-1] != start:
                loop.append(following[loop[-1]].pop())
            loops.append(np.array(loop))
    return loops


def dashes(points: np.ndarray, length: float) -> list[np.ndarray]:
    """Return every second piece of the given length [m] of a polyline (p, 3), ends included, each (2, 3)."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    num = 2 * max(round((arc[-1] / length - 1.0) / 2.0), 0) + 1
    at = np.linspace(0.0, arc[-1], num + 1)
    ends = np.stack([np.interp(at, arc, column) for column in np.transpose(points)], axis=1)
    return [ends[index : index + 2] for index in range(0, num, 2)]


def gripper_surfaces(drawing: Drawing) -> list[Surface]:
    """Return a ball for each closed gripper, and one cut in two halves that stand apart for each open one."""
    return [
        gripper_shape(is_closed=bool(is_closed)).moved(position)
        for position, is_closed in zip(drawing.grippers, drawing.closed, strict=True)
    ]


def gripper_shape(*, is_closed: bool) -> Surface:
    """Return a gripper at the origin, see `gripper_surfaces`."""
    return _ball() if is_closed else _open_jaws()


@lru_cache
def _ball() -> Surface:
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=JAW_RADIUS)
    vertices = mesh.vertices.view(np.ndarray)
    return Surface(vertices, mesh.faces.view(np.ndarray), vertices / JAW_RADIUS)


@lru_cache
def _open_jaws() -> Surface:
    ball = _ball()
    halves = []
    for side in (1.0, -1.0):
        # Pressed flat on one side, the ball is half a ball.
        half = side * np.maximum(side * ball.vertices * (1.0, 0.0, 0.0), 0.0) + ball.vertices * (0.0, 1.0, 1.0)
        halves.append(solid_surface(Solid(half + [side * JAW_OPENING / 2.0, 0.0, 0.0], ball.faces)))
    return _joined(halves)


def _joined(surfaces: list[Surface]) -> Surface:
    """Return several surfaces as one, without any vertex if there are none."""
    if not surfaces:
        return Surface(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64), np.zeros((0, 3)))
    starts = np.cumsum([0] + [len(surface.vertices) for surface in surfaces[:-1]])
    return Surface(
        np.concatenate([surface.vertices for surface in surfaces]),
        np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=True)]),
        np.concatenate([surface.normals for surface in surfaces]),
    )


def _transported_normals(tangents: np.ndarray) -> np.ndarray:
    """Return a unit normal for each tangent (n, 3) that turns about it as little as possible, (n, 3)."""
    ax, ay, az = np.eye(3)[np.abs(tangents[0]).argmin()].tolist()
    normals = []
    for x, y, z in tangents.tolist():  # in plain numbers: a tenth of the time that short arrays take
        along = ax * x + ay * y + az * z
        ax, ay, az = ax - along * x, ay - along * y, az - along * z
        length = max(math.sqrt(ax * ax + ay * ay + az * az), 1e-9)
        ax, ay, az = ax / length, ay / length, az / length
        normals.append((ax, ay, az))
    return np.array(normals)


def _grid_faces(num_rings: int) -> np.ndarray:
    """Return the faces of a tube of rings of vertices, (F, 3)."""
    ring, side = np.meshgrid(np.arange(num_rings - 1), np.arange(TUBE_SIDES), indexing="ij")
    following = (side + 1) % TUBE_SIDES
    a, b = ring * TUBE_SIDES + side, ring * TUBE_SIDES + following
    c, d = a + TUBE_SIDES, b + TUBE_SIDES
    return np.concatenate([np.stack([a, b, d], -1), np.stack([a, d, c], -1)]).reshape(-1, 3)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _flat_rectangles(bounds: np.ndarray, height: float) -> Surface:
    """Return level rectangles with bounds (n, 4) as low x, low y, high x, high y [m]."""
    corners = bounds[:, [[0, 1], [2, 1], [2, 3], [0, 3]]].reshape(-1, 2)
    faces = 4 * np.arange(len(bounds))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    vertices = np.pad(corners, ((0, 0), (0, 1)), constant_values=height)
    return Surface(vertices, faces.reshape(-1, 3), np.tile([0.0, 0.0, 1.0], (len(vertices), 1)))
