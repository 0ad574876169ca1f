"""Meshes of ropes, cloth, obstacles, grippers and marks."""

import numpy as np
import pytest
import torch
import trimesh

from maniskill_grpd.physics import (
    Solver,
    box,
    capsule,
    circle_outline,
    cloth,
    cylinder,
    plane,
    prism,
    sphere,
    square_outline,
    triangle_mesh,
)
from maniskill_grpd.tasks.pictures.collider_solids import collider_solids
from maniskill_grpd.tasks.pictures.drawing import Drawing, Line, Sheet, Solid, Tube
from maniskill_grpd.tasks.pictures.surfaces import (
    boundary_loops,
    dashes,
    ghost_surface,
    gripper_surfaces,
    mark_surface,
    shadow_surface,
    sheet_surface,
    solid_surface,
    surface_of,
    tube_surface,
)


@pytest.fixture(scope="module")
def holed():
    """A square cloth with a hole."""
    return cloth(square_outline(0.4), [circle_outline(0.05)], num_nodes=200)


def outward_share(surface):
    """Return the share of faces with an area whose winding agrees with the normals of the surface."""
    corners = surface.vertices[surface.faces]
    winding = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    has_area = np.linalg.norm(winding, axis=1) > 1e-12
    return ((winding * surface.normals[surface.faces].mean(axis=1)).sum(axis=1) > 0.0)[has_area].mean()


# ---------------------------------------------------------------- ropes


@pytest.mark.parametrize("turn", [0.0, 3.0])
def test_a_tube_is_closed_and_as_thick_as_its_rope(turn):
    angle = np.linspace(0.0, turn, 41)
    x = np.linspace(0.0, 0.4, 41)
    points = np.stack([x, 0.1 * np.sin(angle), 0.1 * np.cos(angle)], axis=1)
    tube = tube_surface(points, 0.01)
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    mesh = trimesh.Trimesh(tube.vertices, tube.faces)
    mesh.merge_vertices(digits_vertex=9)
    mesh.update_faces(mesh.nondegenerate_faces())
    # Twelve sides have 6 / pi sin(pi / 6) = 0.955 times the cross-section of a circle.
    assert mesh.volume == pytest.approx(0.955 * np.pi * 1e-4 * (length + 4.0 / 3.0 * 0.01), rel=0.02)
    assert mesh.is_watertight
    assert outward_share(tube) == 1.0
    np.testing.assert_allclose(np.linalg.norm(tube.normals, axis=1), 1.0)


def test_a_tube_along_a_line_that_stands_still_has_no_hole():
    tube = tube_surface(np.array([[0.0, 0.0, 0.0]] * 2 + [[0.1, 0.0, 0.0]]), 0.01)
    assert np.isfinite(tube.vertices).all()


# ---------------------------------------------------------------- cloth


def test_normals_of_a_sheet_point_out_of_its_front(holed):
    surface = sheet_surface(Sheet(holed.rest_positions, holed.faces))
    np.testing.assert_allclose(surface.normals, np.broadcast_to([0.0, 0.0, 1.0], surface.normals.shape), atol=1e-6)


def test_boundary_of_a_sheet_is_its_outline_and_its_holes(holed):
    loops = boundary_loops(holed.faces)
    assert len(loops) == 2
    for loop in loops:
        assert loop[0] == loop[-1]
        assert len(set(loop.tolist())) == len(loop) - 1
    hole = min(loops, key=len)
    assert set(hole.tolist()) == set(holed.node_sets["hole"].tolist())
    assert set(np.concatenate(loops).tolist()) == set(holed.node_sets["boundary"].tolist()) | set(hole.tolist())


def test_boundary_of_faces_that_touch_at_a_corner_goes_around_each():
    faces = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7]])
    loops = boundary_loops(faces)
    sides = {(int(i), int(j)) for loop in loops for i, j in zip(loop[:-1], loop[1:], strict=True)}
    assert sides == {(0, 1), (1, 2), (2, 0), (2, 3), (3, 4), (4, 2), (5, 6), (6, 7), (7, 5)}
    assert sum(len(loop) - 1 for loop in loops) == 9


# ---------------------------------------------------------------- obstacles

MESH = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
COLLIDERS = {
    "sphere": (sphere(0.05), 4.0 / 3.0 * np.pi * 0.05**3),
    "capsule": (capsule(0.03, 0.1), np.pi * 0.03**2 * (0.2 + 4.0 / 3.0 * 0.03)),
    "box": (box(0.1, 0.2, 0.05), 8.0 * 0.1 * 0.2 * 0.05),
    "cylinder": (cylinder(0.03, 0.1), np.pi * 0.03**2 * 0.2),
    "prism": (prism(np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]]), 0.02), 0.5 * 0.1**2 * 0.04),
    "mesh": (triangle_mesh(MESH.vertices, MESH.faces), MESH.volume),
}


@pytest.mark.parametrize("name", COLLIDERS)
def test_obstacles_look_as_they_are(holed, name):
    collider, volume = COLLIDERS[name]
    solver = Solver(holed, 2, 1, colliders=[plane(), collider])
    (solid,) = collider_solids(solver, 1)
    mesh = trimesh.Trimesh(solid.vertices, solid.faces)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(volume, rel=0.03)  # round ones have flat sides
    surface = solid_surface(solid)
    assert outward_share(surface) == 1.0
    # Where they are in the physics: along local z, about the origin.
    if name in ("capsule", "cylinder", "prism"):
        np.testing.assert_allclose(mesh.bounds[:, 2].sum(), 0.0, atol=1e-6)


def test_obstacles_stand_where_the_world_has_them(holed):
    solver = Solver(holed, 2, 1, colliders=[box(0.1, 0.02, 0.02), sphere(0.03)])
    solver.collider_positions[1, 0] = torch.tensor([0.3, 0.2, 0.1])
    solver.collider_rotations[1, 0] = torch.tensor([0.5**0.5, 0.0, 0.0, 0.5**0.5])
    solver.collider_sizes[1, 0] = torch.tensor([0.2, 0.02, 0.02])
    solver.collider_active[1, 1] = False
    (bar,) = collider_solids(solver, 1)
    np.testing.assert_allclose(bar.vertices.min(axis=0), [0.28, 0.0, 0.08], atol=1e-6)
    np.testing.assert_allclose(bar.vertices.max(axis=0), [0.32, 0.4, 0.12], atol=1e-6)
    assert len(collider_solids(solver, 0)) == 2


def test_edges_of_solids_are_sharp_and_round_sides_smooth():
    cube = trimesh.creation.box()
    surface = solid_surface(Solid(cube.vertices, cube.faces))
    assert (np.abs(surface.normals).max(axis=1) > 0.999).all()
    tin = trimesh.creation.cylinder(radius=1.0, height=2.0, sections=48)
    surface = solid_surface(Solid(tin.vertices, tin.faces))
    on_side = np.abs(surface.normals[:, 2]) < 0.5
    np.testing.assert_allclose((surface.normals * surface.vertices)[on_side][:, :2].sum(axis=1), 1.0, atol=1e-3)


# ---------------------------------------------------------------- grippers, marks, shadows


def drawing(**changes):
    """Return a drawing of a short rope."""
    rope = Tube(np.array([[0.0, 0.0, 0.01], [0.1, 0.0, 0.01]]), 0.01)
    given = {"grippers": np.zeros((0, 3)), "closed": np.zeros(0, dtype=bool), "is_solved": False}
    return Drawing(object=rope, **(given | changes))


def test_open_grippers_are_two_halves_of_the_ball_of_closed_ones():
    at = np.array([[0.1, 0.2, 0.3], [-0.1, 0.0, 0.1]])
    closed, opened = gripper_surfaces(drawing(grippers=at, closed=np.array([True, False])))
    volumes = [trimesh.Trimesh(surface.vertices, surface.faces).volume for surface in (closed, opened)]
    assert volumes[1] == pytest.approx(volumes[0], rel=0.05)
    assert np.ptp(opened.vertices[:, 0]) > np.ptp(closed.vertices[:, 0]) + 0.01
    assert np.abs(opened.vertices[:, 0] - at[1, 0]).min() > 0.005
    for surface, position in zip((closed, opened), at, strict=True):
        np.testing.assert_allclose(surface.vertices.mean(axis=0), position, atol=1e-3)
        assert outward_share(surface) == 1.0


def test_lines_are_dashed_from_end_to_end():
    points = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.3, 0.2, 0.0]])
    pieces = dashes(points, 0.02)
    lengths = np.linalg.norm(np.diff(pieces, axis=1)[:, 0], axis=1)
    assert len(pieces) == 13
    assert (np.abs(lengths - 0.02) < 0.004).all()
    np.testing.assert_allclose(pieces[0][0], points[0])
    np.testing.assert_allclose(pieces[-1][1], points[-1])


def test_marks_are_the_outline_of_a_cloth_and_the_lines(holed):
    goal = Sheet(holed.rest_positions, holed.faces)
    assert not len(mark_surface(drawing()).faces)
    outline = mark_surface(drawing(goal=goal)).vertices
    assert np.ptp(outline[:, 0]) == pytest.approx(0.405, abs=1e-3)
    line = Line(np.array([[0.0, -0.3, 0.0], [0.0, 0.3, 0.0]]))
    both = mark_surface(drawing(goal=goal, lines=(line,))).vertices
    assert np.ptp(both[:, 1]) == pytest.approx(0.605, abs=1e-3)


def test_a_cloth_that_is_where_it_should_be_takes_the_place_of_its_goal(holed):
    goal = Sheet(holed.rest_positions, holed.faces)
    assert ghost_surface(drawing()) is None
    assert len(ghost_surface(drawing(goal=goal)).faces) == len(holed.faces)
    assert ghost_surface(drawing(goal=goal, is_solved=True)) is None
    assert len(mark_surface(drawing(goal=goal, is_solved=True)).faces) > 0
    rope = Tube(np.array([[0.0, 0.0, 0.01], [0.1, 0.0, 0.01]]), 0.01)
    assert np.ptp(ghost_surface(drawing(goal=rope, is_solved=True)).vertices[:, 1]) > 0.025


def test_shadows_lie_on_the_table_away_from_the_light():
    solid = trimesh.creation.box(extents=[0.02, 0.02, 0.4])
    solid.apply_translation([0.7, 0.0, 0.2])
    shadow = shadow_surface(surface_of(Solid(solid.vertices, solid.faces)))
    assert (shadow.vertices[:, 2] < 0.001).all()
    assert shadow.vertices[:, 0].max() == pytest.approx(0.8)  # the edge of the table
    assert shadow.vertices[:, 0].min() == pytest.approx(0.69)
    assert shadow.vertices[:, 1].max() > 0.1
