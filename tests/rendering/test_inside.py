"""Points inside closed surfaces, against distances from the middle of a ball and of a box."""

import torch
import trimesh

from maniskill_grpd.rendering import Label, TriangleScene
from maniskill_grpd.rendering.inside import is_inside


def scene_of(mesh, label, num):
    vertices = torch.tensor(mesh.vertices, dtype=torch.float32).expand(num, -1, -1).contiguous()
    faces = torch.tensor(mesh.faces, dtype=torch.int32)[None]
    labels = torch.full(faces.shape[:2], int(label), dtype=torch.int32)
    return TriangleScene(vertices, faces, labels, torch.zeros(num, dtype=torch.int32))


def test_points_in_a_box_are_inside_and_others_are_not():
    points = 2.0 * torch.rand(500, 3, generator=torch.Generator().manual_seed(0)) - 1.0
    scene = scene_of(trimesh.creation.box(extents=[1.0, 0.6, 1.4]), Label.OBSTACLE, 500)
    expected = (points.abs() < torch.tensor([0.5, 0.3, 0.7])).all(dim=1)
    assert torch.equal(is_inside(scene, torch.arange(500), points, [Label.OBSTACLE]), expected)
    assert 20 < expected.sum() < 480


def test_what_is_not_asked_for_does_not_count():
    scene = scene_of(trimesh.creation.icosphere(subdivisions=2), Label.GRIPPER, 1)
    middle = torch.zeros(1, 3)
    assert is_inside(scene, torch.tensor([0]), middle, [Label.OBSTACLE, Label.GRIPPER]).all()
    assert not is_inside(scene, torch.tensor([0]), middle, [Label.OBSTACLE]).any()


def test_each_world_is_its_own():
    scene = scene_of(trimesh.creation.icosphere(subdivisions=2), Label.OBSTACLE, 2)
    scene.vertices[1] += 3.0
    assert is_inside(scene, torch.arange(2), torch.zeros(2, 3), [Label.OBSTACLE]).tolist() == [True, False]
    assert is_inside(scene, torch.tensor([1]), torch.zeros(1, 3), [Label.OBSTACLE]).tolist() == [False]
