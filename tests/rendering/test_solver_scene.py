"""The triangles of a solver's worlds."""

import numpy as np
import pytest
import torch
import trimesh
from scenes import drawn

from maniskill_grpd.physics import (
    Solver,
    box,
    capsule,
    cloth,
    cylinder,
    plane,
    prism,
    rope,
    sphere,
    square_outline,
    triangle_mesh,
    triangle_outline,
)
from maniskill_grpd.rendering import Label, SolverScene


def part(view, world, label):
    """Return the triangles of a label in one world whose vertices are somewhere, as a mesh."""
    scene = view.scene
    variant = int(scene.variants[world])
    faces = scene.triangles[variant][scene.labels[variant] == label].numpy()
    vertices = scene.vertices[world].numpy().astype(np.float64)
    faces = faces[np.isfinite(vertices[faces]).all(axis=(1, 2))]
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    mesh.merge_vertices(digits_vertex=6)
    mesh.update_faces(mesh.nondegenerate_faces())
    return mesh


@pytest.fixture
def square():
    return cloth(square_outline(0.3), num_nodes=36)


def test_a_rope_is_a_closed_tube_with_round_ends():
    short, long = (rope(np.array([[0.0, 0.0], [length, 0.0]]), num_nodes=num) for length, num in ((0.3, 12), (0.4, 20)))
    solver = Solver([short, long], 3)
    angle = torch.linspace(0.0, 3.0, 20)
    bent = torch.stack([0.4 / 3.0 * angle.sin(), 0.4 / 3.0 * angle.cos(), 0.05 * angle], dim=1)
    shapes = torch.zeros(3, 20, 3)
    shapes[0, :12, 0] = torch.linspace(0.0, 0.3, 12)
    shapes[1], shapes[2] = bent, bent[:, [2, 0, 1]]
    solver.reset(torch.arange(3), shapes, variants=torch.tensor([0, 1, 1]))
    view = SolverScene(solver)
    for world, count in enumerate((12, 20, 20)):
        tube = part(view, world, Label.ROPE)
        points = solver.positions[world, :count].numpy()
        radius, length = solver.models[0].radius, np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        assert tube.is_watertight
        # Twelve sides have 0.955 times the cross-section of a circle.
        assert tube.volume == pytest.approx(0.955 * np.pi * radius**2 * (length + 4.0 / 3.0 * radius), rel=0.03)


@pytest.mark.parametrize(
    ("collider", "size", "volume"),
    [
        (sphere(0.05), (0.04, 1.0, 1.0), 4.0 / 3.0 * np.pi * 0.04**3),
        (capsule(0.02, 0.1), (0.03, 0.05, 1.0), np.pi * 0.03**2 * (0.1 + 4.0 / 3.0 * 0.03)),
        (box(0.1, 0.1, 0.1), (0.1, 0.02, 0.03), 8.0 * 0.1 * 0.02 * 0.03),
        (cylinder(0.02, 0.1), (0.03, 0.05, 1.0), np.pi * 0.03**2 * 0.1),
        (prism(triangle_outline(0.1), 0.1), (2.0, 0.05, 1.0), 4.0 * np.sqrt(3.0) / 4.0 * 0.01 * 0.1),
        (triangle_mesh(trimesh.creation.box([0.1] * 3).vertices, trimesh.creation.box([0.1] * 3).faces), (2.0, 1.0, 1.0), 0.2**3),
    ],
)
def test_obstacles_have_the_size_pose_and_switch_of_their_world(square, collider, size, volume):
    solver = Solver(square, 3, colliders=[plane(), collider])
    solver.collider_sizes[1, 1] = torch.tensor(size)
    solver.collider_positions[1, 1] = torch.tensor([0.1, -0.2, 0.3])
    turn = torch.tensor([0.5, 0.5, 0.5, 0.5])  # x to y, y to z, z to x
    solver.collider_rotations[1, 1] = turn
    solver.collider_active[2, 1] = False
    view = SolverScene(solver)
    body = part(view, 1, Label.OBSTACLE)
    assert body.is_watertight
    assert body.volume == pytest.approx(volume, rel=0.02)
    assert len(part(view, 2, Label.OBSTACLE).faces) == 0
    straight = part(view, 0, Label.OBSTACLE)
    solver.collider_sizes[0, 1], solver.collider_positions[0, 1] = torch.tensor(size), 0.0
    view.update()
    moved = part(view, 0, Label.OBSTACLE).bounds
    assert np.abs(straight.bounds - moved).max() > 0.005
    np.testing.assert_allclose(body.bounds, moved[:, [2, 0, 1]] + [0.1, -0.2, 0.3], atol=1e-6)


def test_grippers_are_balls_that_open(square):
    solver = Solver(square, 1, num_grippers=2)
    solver.gripper_positions[0] = torch.tensor([[0.1, 0.0, 0.2], [-0.1, 0.0, 0.2]])
    solver.closed[0] = torch.tensor([True, False])
    view = SolverScene(solver)
    balls = part(view, 0, Label.GRIPPER).split(only_watertight=True)
    assert sorted(round(float(ball.bounds.mean(axis=0)[0]), 3) for ball in balls) == pytest.approx(
        [-0.111, -0.089, 0.1], abs=0.01
    )
    solver.closed[0] = True
    view.update()
    assert len(part(view, 0, Label.GRIPPER).split(only_watertight=True)) == 2


def test_every_pixel_says_what_it_shows(square):
    solver = Solver(square, 2, num_grippers=1, colliders=[sphere(0.05)])
    solver.collider_positions[:, 0] = torch.tensor([0.3, 0.0, 0.05])
    solver.gripper_positions[:, 0] = torch.tensor([-0.3, 0.0, 0.05])
    view = SolverScene(solver)
    images = drawn(view.scene, size=160, eyes=((0.0, 0.0, 1.0),), fov=2.0)
    assert set(images.segmentation().unique().tolist()) == {Label.NONE, Label.TABLE, Label.CLOTH, Label.GRIPPER, Label.OBSTACLE}
    without = drawn(SolverScene(solver, has_table=False).scene, size=160, eyes=((0.0, 0.0, 1.0),), fov=2.0)
    assert Label.TABLE not in without.segmentation().unique().tolist()


def test_the_scene_follows_the_solver(square):
    solver = Solver(square, 2)
    view = SolverScene(solver)
    solver.positions[1, :, 2] += 0.1
    before = part(view, 1, Label.CLOTH).bounds
    view.update()
    np.testing.assert_allclose(part(view, 1, Label.CLOTH).bounds, before + [0.0, 0.0, 0.1], atol=1e-6)
    np.testing.assert_allclose(part(view, 0, Label.CLOTH).bounds, before, atol=1e-6)


def test_cloths_of_different_shapes_have_their_own_triangles():
    models = [cloth(square_outline(0.3), num_nodes=25), cloth(triangle_outline(0.4), num_nodes=40)]
    solver = Solver(models, 2)
    solver.reset(torch.arange(2), variants=torch.tensor([1, 0]))
    view = SolverScene(solver)
    for world, model in ((0, models[1]), (1, models[0])):
        mesh = part(view, world, Label.CLOTH)
        assert len(mesh.faces) == len(model.faces)
        assert mesh.area == pytest.approx(trimesh.Trimesh(model.rest_positions, model.faces).area, rel=1e-4)
