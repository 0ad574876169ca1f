"""Depth, coverage and independence of the rasteriser, against closed forms and ray casts."""

import numpy as np
import pytest
import torch
import trimesh
from scenes import drawn, first_hits, folded_cloths, grid_faces, pixel_rays, rasterizer, ray_cast, scene_of

from maniskill_grpd.rendering import Label, Lens, Rasterizer, TriangleScene, intrinsic_from_fov
from maniskill_grpd.rendering import rasterizer as module

SQUARE = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]])


def interior(mask):
    """Return the pixels all of whose neighbours are of the same kind: those away from silhouettes."""
    same = np.ones_like(mask, dtype=bool)
    padded = np.pad(mask, 1, mode="edge")
    for dy in range(3):
        for dx in range(3):
            same &= padded[dy : dy + mask.shape[0], dx : dx + mask.shape[1]] == mask
    return same


# ---------------------------------------------------------------- closed forms


@pytest.mark.parametrize("eye", [(0.1, -0.4, 0.5), (0.0, 0.0, 0.3), (-0.6, 0.5, 0.5)])
def test_the_depth_of_a_plane_is_that_of_the_formula(eye):
    images = drawn(scene_of(50.0 * SQUARE[None], SQUARE_FACES), eyes=(eye,), fov=0.6, far=200.0)
    start, rays = pixel_rays(images, 0, 0)
    expected = -start[2] / rays[..., 2]
    seen = np.isfinite(images.depth()[0, 0].numpy())
    assert seen.all()
    np.testing.assert_allclose(images.depth()[0, 0], expected, rtol=1e-5)


def test_the_depth_of_a_sphere_is_that_of_the_formula():
    ball = trimesh.creation.icosphere(subdivisions=5, radius=0.1)
    images = drawn(scene_of(ball.vertices[None], ball.faces), size=96, fov=0.5)
    start, rays = pixel_rays(images, 0, 0)
    a, b, c = (rays**2).sum(-1), rays @ start, start @ start - 0.01
    root = b * b - a * c
    expected = np.where(root > 0.0, (-b - np.sqrt(np.maximum(root, 0.0))) / a, np.inf)
    depth = images.depth()[0, 0].numpy()
    assert (np.isfinite(depth) != np.isfinite(expected)).mean() < 1e-3
    clear = root > 0.05 * root.max()
    np.testing.assert_allclose(depth[clear], expected[clear], atol=1e-4)
    normals = images.normals()[0, 0].numpy()[clear] @ images.extrinsics[0, 0, :, :3].numpy()
    np.testing.assert_allclose(normals, (start + expected[..., None] * rays)[clear] / 0.1, atol=0.04)


# ---------------------------------------------------------------- against ray casts


@pytest.mark.parametrize("size", [64, 128])
def test_depth_and_masks_are_those_of_a_ray_cast(size):
    cloths, faces = folded_cloths(6), grid_faces(16)
    images = drawn(scene_of(cloths, faces), size=size, eyes=((0.1, -0.4, 0.5), (0.5, 0.1, 0.2)))
    depths, wrong, pixels = images.depth().numpy(), 0, 0
    for world in range(6):
        for camera in range(2):
            expected, hit = ray_cast(cloths[world], faces, *pixel_rays(images, world, camera))
            seen, depth = np.isfinite(expected), depths[world, camera]
            wrong += (seen != np.isfinite(depth)).sum()
            pixels += seen.size
            same = images.faces[world, camera].numpy() == hit
            assert (same | ~interior(hit)).mean() > 0.999
            np.testing.assert_allclose(depth[same & seen], expected[same & seen], atol=1e-4)
    assert wrong < 1e-3 * pixels


def test_depth_is_that_of_a_test_of_all_triangles():
    (cloth,), faces = folded_cloths(1, n=8, seed=3), grid_faces(8)
    images = drawn(scene_of(cloth[None], faces), size=24)
    start, rays = pixel_rays(images, 0, 0)
    expected = first_hits(cloth, faces, start, rays.reshape(-1, 3)).reshape(24, 24)
    depth = images.depth()[0, 0].numpy()
    assert np.isfinite(expected).sum() > 50
    assert (np.isfinite(depth) != np.isfinite(expected)).sum() <= 1
    both = np.isfinite(depth) & np.isfinite(expected)
    assert (np.abs(depth[both] - expected[both]) > 1e-4).sum() <= 1


# ---------------------------------------------------------------- coverage


def test_triangles_that_share_sides_leave_no_gap_and_do_not_overlap():
    """The vertices are moved within the picture alone, so that every pixel of the square belongs to exactly one triangle."""
    rng = np.random.default_rng(0)
    n, faces = 9, grid_faces(9)
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, n), np.linspace(-1.0, 1.0, n))
    inner = (np.abs(x) < 0.9) & (np.abs(y) < 0.9)
    move = rng.uniform(-0.1, 0.1, (n, n, 2)) * inner[..., None]
    vertices = np.stack([x + move[..., 0], y + move[..., 1], 0.0 * x], axis=-1).reshape(1, -1, 3)
    parts = np.tile(vertices, (len(faces), 1, 1))
    triangles = torch.tensor(faces)[:, None].contiguous()
    single = TriangleScene(
        torch.tensor(parts, dtype=torch.float32),
        triangles,
        torch.ones_like(triangles[..., 0]),
        torch.arange(len(faces), dtype=torch.int32),
    )
    setting = {"size": 80, "eyes": ((0.0, 0.0, 1.0),), "fov": 1.5}
    counts = (drawn(single, **setting).faces >= 0).sum(dim=0)
    assert set(counts.unique().tolist()) == {1}
    assert (drawn(scene_of(vertices, faces), **setting).faces >= 0).all()


def test_a_plane_that_passes_the_camera_is_cut_at_the_near_plane():
    """Both triangles of the plane cross it: without the cut there would be nothing to see."""
    images = drawn(
        scene_of(20.0 * SQUARE[None], SQUARE_FACES), eyes=((0.1, 0.2, 0.3),), targets=((2.0, 1.0, 0.3),), near=0.05, far=15.0
    )
    start, rays = pixel_rays(images, 0, 0)
    expected = np.where(rays[..., 2] < 0.0, -start[2] / np.minimum(rays[..., 2], -1e-9), np.inf)
    expected[expected > 15.0] = np.inf
    depth = images.depth()[0, 0].numpy()
    assert 0.3 < np.isfinite(depth).mean() < 0.5
    assert (np.isfinite(depth) == np.isfinite(expected)).all()
    np.testing.assert_allclose(depth[np.isfinite(depth)], expected[np.isfinite(expected)], rtol=1e-4)


def test_what_is_nearer_than_the_near_plane_is_not_seen():
    close = np.array([[-0.05, -0.05, 0.45], [0.05, -0.05, 0.45], [0.0, 0.05, 0.45]])
    scene = scene_of(np.concatenate([SQUARE, close])[None], np.concatenate([SQUARE_FACES, [[4, 5, 6]]]))
    near, far = (drawn(scene, eyes=((0.0, 0.0, 0.5),), near=near).faces for near in (0.01, 0.06))
    assert (near == 2).any()
    assert (far != 2).all()


@pytest.mark.parametrize(
    "extra",
    [
        [[5.0, 5.0, 0.2], [5.2, 5.0, 0.2], [5.0, 5.2, 0.2]],  # beside the image
        [[0.0, 0.0, 2.0], [0.2, 0.0, 2.0], [0.0, 0.2, 2.0]],  # behind the camera
        [[0.0, 0.0, 0.2], [0.0, 0.0, 0.2], [0.0, 0.1, 0.2]],  # a line
        [[0.0, 0.0, 0.2]] * 3,  # a point
        [[np.nan] * 3] * 3,
        [[np.nan] * 3, [0.1, 0.0, 0.2], [0.0, 0.1, 0.2]],
    ],
)
def test_what_cannot_be_seen_changes_nothing(extra):
    cloth, faces = folded_cloths(1), grid_faces(16)
    setting = {"eyes": ((0.0, 0.0, 0.5),)}
    bare = drawn(scene_of(cloth, faces), **setting)
    more = np.concatenate([cloth, np.array(extra, np.float32)[None]], axis=1)
    images = drawn(scene_of(more, np.concatenate([faces, [[256, 257, 258]]])), **setting)
    assert torch.equal(bare.nearness, images.nearness)
    assert torch.equal(bare.faces, images.faces)


# ---------------------------------------------------------------- independence


def test_an_image_depends_on_its_own_world_alone(monkeypatch):
    """Neither the batch, nor the threads that share the images, nor the bands that one is drawn in change a bit."""
    cloths, faces = folded_cloths(37), grid_faces(16)
    eyes = ((0.1, -0.4, 0.5), (0.5, 0.1, 0.2))
    whole = drawn(scene_of(cloths, faces), size=40, eyes=eyes, num_threads=1)
    alone = drawn(scene_of(cloths[5:6], faces), size=40, eyes=eyes)
    assert torch.equal(whole.nearness[5:6], alone.nearness)
    assert torch.equal(whole.faces[5:6], alone.faces)
    single = drawn(scene_of(cloths, faces), size=40, eyes=eyes[1:])
    assert torch.equal(whole.nearness[:, 1:], single.nearness)
    shared = drawn(scene_of(cloths, faces), size=40, eyes=eyes, num_threads=3)
    assert torch.equal(whole.nearness, shared.nearness)
    monkeypatch.setattr(module, "rows_per_thread", lambda height, device: 7)
    banded = drawn(scene_of(cloths, faces), size=40, eyes=eyes)
    assert torch.equal(whole.nearness, banded.nearness)
    assert torch.equal(whole.faces, banded.faces)


def test_the_order_of_triangles_does_not_matter():
    cloths, faces = folded_cloths(4), grid_faces(16)
    order = np.random.default_rng(0).permutation(len(faces))
    images, permuted = drawn(scene_of(cloths, faces)), drawn(scene_of(cloths, faces[order]))
    assert torch.equal(images.nearness, permuted.nearness)
    back = torch.cat([torch.tensor([-1]), torch.as_tensor(order)])
    assert (back[permuted.faces.long() + 1] == images.faces).float().mean() > 0.999  # two may be equally near


def test_drawing_again_shows_the_world_as_it_is_now():
    cloths, faces = folded_cloths(2), grid_faces(16)
    scene = scene_of(cloths[:1], faces)
    images = drawn(scene)
    first = images.nearness.clone()
    scene.vertices.copy_(torch.as_tensor(cloths[1:]))
    images.draw()
    assert not torch.equal(images.nearness, first)
    assert torch.equal(images.nearness, drawn(scene_of(cloths[1:], faces)).nearness)
    images.extrinsics[:, :, 0, 3] += 0.1
    images.draw()
    assert not torch.equal(images.nearness, drawn(scene).nearness)


def test_worlds_take_their_own_triangles():
    faces = torch.tensor([[[0, 1, 2], [0, 2, 3]], [[0, 1, 2], [0, 0, 0]]], dtype=torch.int32)
    vertices = torch.tensor(SQUARE, dtype=torch.float32).repeat(2, 1, 1)
    labels = torch.tensor([[1, 1], [2, 2]], dtype=torch.int32)
    scene = TriangleScene(vertices, faces, labels, torch.tensor([0, 1], dtype=torch.int32))
    images = drawn(scene, eyes=((0.0, 0.0, 1.0),), fov=1.5)
    square, triangle = images.segmentation()[:, 0]
    assert set(square.unique().tolist()) == {Label.TABLE}
    assert set(triangle.unique().tolist()) == {Label.NONE, Label.CLOTH}
    assert (triangle > 0).float().mean() == pytest.approx(0.5, abs=0.02)


# ---------------------------------------------------------------- what images tell


def test_positions_are_where_the_rays_end():
    images = drawn(scene_of(folded_cloths(2), grid_faces(16)), eyes=((0.1, -0.4, 0.5), (0.5, 0.1, 0.2)))
    positions, depth = images.positions(), images.depth()
    seen = torch.isfinite(depth)
    assert torch.equal(positions[..., 2][seen], depth[seen])
    assert (positions[~seen] == 0.0).all()
    start, rays = pixel_rays(images, 1, 1)
    extrinsic = images.extrinsics[1, 1].numpy()
    expected = (start + depth[1, 1].nan_to_num(posinf=0.0).numpy()[..., None] * rays) @ extrinsic[:, :3].T + extrinsic[:, 3]
    np.testing.assert_allclose(positions[1, 1][seen[1, 1]], expected[seen[1, 1].numpy()], atol=1e-5)


def test_both_sides_of_a_cloth_are_seen_each_in_its_colour():
    red, blue = (torch.tensor(color).expand(1, 2, 3).contiguous() for color in ([0.9, 0.1, 0.1], [0.1, 0.1, 0.9]))
    sides = [
        drawn(scene_of(SQUARE[None], faces, fronts=red, backs=blue), eyes=((0.0, 0.0, 1.0),), fov=1.5)
        for faces in (SQUARE_FACES, SQUARE_FACES[:, ::-1].copy())
    ]
    assert torch.equal(sides[0].depth(), sides[1].depth())
    assert torch.equal(sides[0].normals(), sides[1].normals())
    front, back = (images.colors().float().mean(dim=(0, 1, 2, 3)) for images in sides)
    assert front[0] > 2.0 * front[2]
    assert back[2] > 2.0 * back[0]


def test_where_nothing_is_there_is_nothing():
    images = drawn(scene_of(SQUARE[None] + [0.0, 0.0, 9.0], SQUARE_FACES))
    assert (images.faces == -1).all()
    assert torch.isinf(images.depth()).all()
    for values in (images.segmentation(), images.positions(), images.normals()):
        assert (values == 0).all()


# ---------------------------------------------------------------- bad input


def test_impossible_cameras_and_scenes_are_refused():
    scene = scene_of(SQUARE[None], SQUARE_FACES)
    matrix, extrinsics = intrinsic_from_fov(1.0, 8, 8)[None], torch.zeros(1, 3, 4)
    for side in (0, -1, 5000, 2.5):
        with pytest.raises(ValueError, match="1 ... 4096 pixels"):
            Lens(side, 8)
    with pytest.raises(ValueError, match="near and far"):
        Lens(8, 8, near=1.0, far=0.5)
    with pytest.raises(ValueError, match="between 0 and pi"):
        intrinsic_from_fov(3.2, 8, 8)
    with pytest.raises(ValueError, match="intrinsics must be"):
        Rasterizer(scene, Lens(8, 8), matrix[:, :2], extrinsics)
    with pytest.raises(ValueError, match="extrinsics must be"):
        Rasterizer(scene, Lens(8, 8), matrix, extrinsics.expand(3, 1, 3, 4))
    with pytest.raises(ValueError, match="must be in"):
        scene_of(SQUARE[None], SQUARE_FACES + 1)
    with pytest.raises(ValueError, match="float32"):
        TriangleScene(scene.vertices.double(), scene.triangles, scene.labels, scene.variants)


def test_images_that_take_too_much_memory_are_refused_before_it_is_taken():
    scene = scene_of(np.tile(SQUARE, (1000, 1, 1)), SQUARE_FACES)
    with pytest.raises(ValueError, match="1000 worlds x 1 cameras of 4096x4096 pixels would take 125.0 GiB, more than 8"):
        rasterizer(scene, size=4096)
