"""Creases across flat sheets."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from maniskill_grpd.physics import circle_outline, cloth, rectangle_outline, square_outline
from maniskill_grpd.physics.mesh.outlines import distance_to, signed_area
from maniskill_grpd.tasks import CLOTH_SHAPES
from maniskill_grpd.tasks.geometry.cloth_shapes import cloth_outline
from maniskill_grpd.tasks.geometry.crease import (
    area_beyond,
    corner_directions,
    crease_ends,
    cut_open,
    hull_corners,
    is_convex,
    mirror,
    offset_of_share,
    side_directions,
    signed_distances,
)
from maniskill_grpd.tasks.geometry.fold_directions import fold_directions

shapes = st.sampled_from(list(CLOTH_SHAPES))
angles = st.floats(-np.pi, np.pi)


def random_creases(seed: int, dimension: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    normal = torch.nn.functional.normalize(torch.randn(4, dimension, generator=generator), dim=-1)
    return torch.randn(4, 7, dimension, generator=generator), normal, torch.randn(4, generator=generator)


def clipped(outline: np.ndarray, normal: np.ndarray, offset: float) -> np.ndarray:
    """Return the part of a polygon beyond a crease (Sutherland and Hodgman), maybe with edges that run along it twice."""
    height = outline @ normal - offset
    corners = []
    for here, there, first, second in zip(outline, np.roll(outline, -1, 0), height, np.roll(height, -1), strict=True):
        if first >= 0:
            corners.append(here)
        if (first >= 0) != (second >= 0):
            corners.append(here + first / (first - second) * (there - here))
    return np.array(corners)


def as_batch(outline: np.ndarray, angle: float) -> tuple[torch.Tensor, torch.Tensor]:
    normal = torch.tensor([[np.cos(angle), np.sin(angle)]], dtype=torch.float32)
    return torch.as_tensor(outline, dtype=torch.float32)[None], normal


@given(st.integers(0, 10_000), st.sampled_from([2, 3]))
def test_mirror_images_are_as_far_on_the_other_side_and_mirror_back(seed, dimension):
    points, normal, offset = random_creases(seed, dimension)
    image = mirror(points, normal, offset)
    torch.testing.assert_close(
        signed_distances(image, normal, offset), -signed_distances(points, normal, offset), atol=2e-5, rtol=0
    )
    torch.testing.assert_close(mirror(image, normal, offset), points, atol=2e-5, rtol=0)
    torch.testing.assert_close(torch.cdist(image, image), torch.cdist(points, points), atol=2e-3, rtol=0)
    on_crease = points - signed_distances(points, normal, offset)[..., None] * normal[:, None]
    torch.testing.assert_close(mirror(on_crease, normal, offset), on_crease, atol=2e-5, rtol=0)


@given(shapes, angles, st.floats(-1.0, 1.0))
def test_area_beyond_is_that_of_the_clipped_polygon(name, angle, offset):
    outline = cloth_outline(name, 1.0)
    batch, normal = as_batch(outline, angle)
    part = clipped(outline, normal[0].numpy().astype(np.float64), offset)
    expected = signed_area(part) if len(part) else 0.0
    assert area_beyond(batch, normal, torch.tensor([offset]))[0] == pytest.approx(expected, abs=2e-5)


@given(shapes, angles, st.floats(0.01, 0.99))
def test_creases_cut_off_the_wanted_share_and_end_on_the_outline(name, angle, share):
    outline = cloth_outline(name, 0.05)
    batch, normal = as_batch(outline, angle)
    offset = offset_of_share(batch, normal, torch.tensor([share]))
    assert area_beyond(batch, normal, offset)[0] / signed_area(outline) == pytest.approx(share, abs=1e-4)
    ends = crease_ends(batch, normal, offset)
    torch.testing.assert_close(signed_distances(ends, normal, offset), torch.zeros(1, 2), atol=1e-6, rtol=0)
    assert distance_to(outline, ends[0].numpy().astype(np.float64)).max() < 1e-5
    first, second = ends[0]
    tangent = torch.stack([-normal[0, 1], normal[0, 0]])
    assert (second - first) @ tangent > 0.0


def test_repeated_points_pad_outlines_without_changing_areas():
    outline = cloth_outline("l_shape", 1.0)
    batch, normal = as_batch(outline, 0.4)
    padded = torch.cat([batch, batch[:, -1:].expand(-1, 5, -1)], dim=1)
    offset = torch.tensor([0.1])
    torch.testing.assert_close(area_beyond(padded, normal, offset), area_beyond(batch, normal, offset))


@pytest.mark.parametrize(
    ("name", "num_sides"), [("square", 4), ("rectangle", 4), ("triangle", 3), ("hexagon", 6), ("circle", 48), ("l_shape", 4)]
)
def test_side_directions_point_out_of_the_sides(name, num_sides):
    outline = cloth_outline(name, 1.0)
    directions = side_directions(outline)
    assert directions.shape == (num_sides, 2)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    heights = outline @ directions.T
    farthest = np.isclose(heights, heights.max(axis=0), atol=1e-9)
    assert (farthest.sum(axis=0) == 2).all()
    # They are the two ends of one side: neighbours in the outline.
    assert (farthest & np.roll(farthest, 1, axis=0)).any(axis=0).all()


def test_corner_directions_bisect_the_corners():
    square = corner_directions(cloth_outline("square", 1.0))
    np.testing.assert_allclose(np.abs(square), np.sqrt(0.5))
    assert len(np.unique(np.sign(square), axis=0)) == 4
    outline = cloth_outline("triangle", 1.0)
    np.testing.assert_allclose(sorted((outline @ corner_directions(outline).T).argmax(axis=0)), [0, 1, 2])


@pytest.mark.parametrize(("name", "num_corners"), [("square", 4), ("triangle", 3), ("hexagon", 6), ("l_shape", 5)])
def test_nodes_along_a_straight_side_are_no_corners(name, num_corners):
    rest = cloth(cloth_outline(name, 0.05), num_nodes=200).rest_positions[:, :2]
    corners = rest[hull_corners(rest)]
    assert len(corners) == num_corners
    assert signed_area(corners) > 0.0


STAR = np.array([[r * np.sin(a), r * np.cos(a)] for a, r in zip(-np.pi * np.arange(10) / 5, [1.0, 0.45] * 5, strict=True)])
ARROW_HEAD = np.array([[0.0, 2.0], [-1.5, -1.0], [0.0, -0.3], [1.5, -1.0]])


def test_outlines_that_are_not_convex_are_folded_along_the_sides_of_their_hull():
    """The notch of an arrow head is bridged by no side; of a star, whose hull bridges notches alone, all five are sides."""
    assert len(side_directions(ARROW_HEAD)) == 2
    directions = side_directions(STAR)
    heights = np.sort(STAR @ directions.T, axis=0)
    assert directions.shape == (5, 2)
    np.testing.assert_allclose(heights[-2:], np.cos(np.pi / 5), rtol=1e-12)  # two tips each
    assert (is_convex(STAR), is_convex(ARROW_HEAD), is_convex(cloth_outline("circle", 1.0))) == (False, False, True)


def test_a_point_on_a_straight_side_changes_no_direction():
    square = cloth_outline("square", 1.0)
    with_middle = np.insert(square, 1, 0.5 * (square[0] + square[1]), axis=0)
    np.testing.assert_allclose(
        sorted(side_directions(with_middle).round(9).tolist()), sorted(side_directions(square).round(9).tolist())
    )


@given(angles, st.floats(-0.4, 0.4))
def test_holes_are_left_out_of_areas_beyond_creases(angle, offset):
    outline = cloth_outline("l_shape", 1.0)
    holes = [circle_outline(0.1, (-0.3, -0.3), num_points=12), square_outline(0.1) + [0.3, -0.4]]
    batch, normal = as_batch(cut_open(outline, holes), angle)
    parts = [clipped(polygon, normal[0].numpy().astype(np.float64), offset) for polygon in (outline, *holes)]
    area, *cut = [signed_area(part) if len(part) else 0.0 for part in parts]
    assert area_beyond(batch, normal, torch.tensor([offset]))[0] == pytest.approx(area - sum(cut), abs=2e-5)
    assert signed_area(cut_open(outline, holes)) == pytest.approx(1.0 - sum(signed_area(hole) for hole in holes))


def test_the_long_sides_of_a_strip_are_not_folded_in():
    """With its ends beyond a crease that is slanted by up to 20 degrees, more than half of a strip would move."""
    strip = rectangle_outline(0.3, 0.04)
    assert len(side_directions(strip)) == 4
    np.testing.assert_allclose(np.abs(fold_directions(strip, 2, "strip")), [[1.0, 0.0], [1.0, 0.0]], atol=1e-12)


def test_cloths_that_cannot_be_folded_are_refused_with_the_reason():
    with pytest.raises(ValueError, match="star needs two grippers.*not convex"):
        fold_directions(STAR, 1, "star")
    with pytest.raises(ValueError, match="sliver cannot be folded.*% of the area or more is, and at most 50% is to move"):
        fold_directions(np.array([[0.0, -1.0], [0.1, 0.0], [0.0, 1.0], [-0.1, 0.0]]), 2, "sliver")
