"""Which points cameras see, against exact tests of the rays to them."""

import numpy as np
import pytest
import torch
from scenes import drawn, first_hits, folded_cloths, grid_faces, pixel_rays, scene_of

TOLERANCE = 1e-3
EYES = ((0.1, -0.4, 0.5), (0.5, 0.1, 0.2))


def seen_by_rays(images, cloth, faces, world, camera):
    """Return which vertices no triangle is in front of by more than the tolerance, for vertices in the image, (V,) bool."""
    start, _ = pixel_rays(images, world, camera)
    extrinsic = images.extrinsics[world, camera].numpy().astype(np.float64)
    local = cloth.astype(np.float64) @ extrinsic[:, :3].T + extrinsic[:, 3]
    pixels = local @ images.intrinsics[camera].numpy().astype(np.float64).T
    pixels = pixels[:, :2] / pixels[:, 2:]
    on_image = (local[:, 2] > 0.0) & (pixels >= 0.0).all(1) & (pixels < images.lens.width).all(1)
    # Rays of unit depth: what they meet first is a depth.
    first = first_hits(cloth, faces, start, (cloth - start) / local[:, 2:])
    return on_image & (first > local[:, 2] - TOLERANCE)


@pytest.mark.parametrize("size", [8, 64])
def test_visible_nodes_are_those_of_exact_rays(size):
    cloths, faces = folded_cloths(12), grid_faces(16)
    images = drawn(scene_of(cloths, faces), size=size, eyes=EYES)
    visible = images.visible(torch.as_tensor(cloths), TOLERANCE).numpy()
    expected = np.array([[seen_by_rays(images, cloths[w], faces, w, c) for c in range(2)] for w in range(12)])
    assert 0.1 < expected.mean() < 0.9
    assert (visible == expected).mean() >= 0.995


def test_the_test_of_pixels_would_not_pass():
    """Comparing the depth of a node with that of its pixel, as is often done, fails on folded cloth."""
    cloths, faces = folded_cloths(12), grid_faces(16)
    images = drawn(scene_of(cloths, faces), size=64, eyes=EYES[1:])
    places = torch.as_tensor(cloths) @ images.extrinsics[0, 0, :, :3].T + images.extrinsics[0, 0, :, 3]
    pixels = places @ images.intrinsics[0].T
    pixels = (pixels[..., :2] / pixels[..., 2:]).long().clamp(0, 63)
    worlds = torch.arange(12)[:, None]
    naive = images.depth()[worlds, 0, pixels[..., 1], pixels[..., 0]] > places[..., 2] - TOLERANCE
    exact = images.visible(torch.as_tensor(cloths), TOLERANCE)[:, 0]
    assert (naive == exact).float().mean() < 0.99


def test_a_node_is_hidden_by_what_lies_over_it_alone():
    cloths, faces = folded_cloths(1), grid_faces(16)
    lid = np.array([[-0.2, -0.2, 0.3], [0.2, -0.2, 0.3], [0.2, 0.2, 0.3], [-0.2, 0.2, 0.3]], np.float32)
    covered = np.concatenate([cloths, lid[None]], axis=1)
    setting = {"eyes": ((0.0, 0.0, 0.6),)}
    bare, hidden = (
        drawn(scene_of(covered, triangles), **setting).visible(torch.as_tensor(cloths), TOLERANCE)
        for triangles in (faces, np.concatenate([faces, [[256, 257, 258], [256, 258, 259]]]))
    )
    assert bare.float().mean() > 0.4
    assert hidden.sum() == 0
    # A lid below the cloth hides nothing.
    covered[:, 256:, 2] = -0.1
    below = drawn(scene_of(covered, np.concatenate([faces, [[256, 257, 258], [256, 258, 259]]])), **setting)
    assert torch.equal(below.visible(torch.as_tensor(cloths), TOLERANCE), bare)


def test_a_large_triangle_that_passes_the_camera_hides_too():
    floor = 20.0 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    images = drawn(scene_of(floor[None], [[0, 1, 2], [0, 2, 3]]), eyes=((0.1, 0.2, 0.3),), targets=((2.0, 1.0, 0.3),))
    points = torch.tensor([[[2.0, 1.0, 0.1], [2.0, 1.0, -0.1], [3.0, 0.5, 0.1], [3.0, 0.5, -0.1], [-1.0, 0.0, 0.1]]])
    assert images.visible(points, TOLERANCE)[0, 0].tolist() == [True, False, True, False, False]


def test_the_tolerance_is_a_depth():
    lid = np.array([[-0.2, -0.2, 0.3], [0.2, -0.2, 0.3], [0.2, 0.2, 0.3], [-0.2, 0.2, 0.3]])
    images = drawn(scene_of(lid[None], [[0, 1, 2], [0, 2, 3]]), eyes=((0.0, 0.0, 0.6),))
    points = torch.tensor([[[0.0, 0.0, 0.29], [0.0, 0.0, 0.27], [0.0, 0.0, 0.31]]])
    assert images.visible(points, 0.02)[0, 0].tolist() == [True, False, True]


def test_points_off_the_image_or_not_finite_are_not_seen():
    images = drawn(scene_of(folded_cloths(1), grid_faces(16)))
    points = torch.tensor([[[9.0, 0.0, 0.0], [0.2, -0.8, 1.0], [torch.nan, 0.0, 0.0], [0.0, 0.0, 0.2]]])
    assert images.visible(points, TOLERANCE)[0, 0].tolist() == [False, False, False, True]
    with pytest.raises(ValueError, match="points must be"):
        images.visible(points[0], TOLERANCE)
    with pytest.raises(ValueError, match="tolerance must be"):
        images.visible(points, -1.0)
