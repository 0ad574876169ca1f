"""Scan conversion, hidden surfaces and translucency."""

import numpy as np
import pytest

from maniskill_grpd.tasks.pictures.rasterizer import Canvas, scan

RED, GREEN, BLUE = np.eye(3)
SQUARE = np.array([[[2, 2], [12, 2], [12, 12]], [[2, 2], [12, 12], [2, 12]]], dtype=float)


@pytest.fixture
def canvas():
    """A black picture that shows nothing yet."""
    return Canvas(np.zeros((16, 20, 3), np.float32), np.zeros((16, 20), np.float32))


def paint(canvas, corners, nearness, color, **glaze):
    """Paint triangles of one colour and one nearness, opaque unless options of `glaze` are given."""
    shape = len(corners), 3
    method = canvas.glaze if glaze else canvas.paint
    method(corners, np.full(shape, nearness), np.broadcast_to(color, (*shape, 3)), **glaze)


def test_pixels_whose_centres_lie_in_a_triangle_are_covered():
    corners = np.random.default_rng(0).uniform(-5.0, 25.0, size=(60, 3, 2))
    fragments = scan(corners, (16, 20))
    covered = np.zeros((60, 16, 20), dtype=int)
    np.add.at(covered, (fragments.faces, fragments.rows, fragments.columns), 1)
    centres = np.stack(np.meshgrid(np.arange(20) + 0.5, np.arange(16) + 0.5), axis=-1)
    start, along = corners, np.roll(corners, -1, axis=1) - corners
    offset = centres[None, None] - start[:, :, None, None]
    side = along[..., None, None, 0] * offset[..., 1] - along[..., None, None, 1] * offset[..., 0]
    np.testing.assert_array_equal(covered, (side > 0.0).all(axis=1) | (side < 0.0).all(axis=1))


def test_neighbouring_triangles_leave_no_gap():
    fragments = scan(SQUARE + 0.3, (16, 20))
    covered = np.zeros((16, 20), dtype=bool)
    covered[fragments.rows, fragments.columns] = True
    expected = np.zeros_like(covered)
    expected[2:12, 2:12] = True
    np.testing.assert_array_equal(covered, expected)


def test_triangles_without_area_and_behind_the_camera_are_not_drawn():
    line = [[[1.0, 1.0], [9.0, 9.0], [5.0, 5.0]]]
    level = [[[1.0, 4.5], [9.0, 4.5], [5.0, 4.5]]]
    behind = [[[1.0, 1.0], [9.0, 1.0], [np.nan, np.nan]]]
    assert not len(scan(np.concatenate([line, level, behind]), (16, 20)).faces)


@pytest.mark.parametrize("order", [1, -1])
def test_the_nearest_is_seen_in_whatever_order_it_is_painted(canvas, order):
    for nearness, color in ((1.0, RED), (2.0, BLUE))[::order]:
        paint(canvas, SQUARE, nearness, color)
    np.testing.assert_array_equal(canvas.colors[5, 5], BLUE)
    assert canvas.nearness[5, 5] == 2.0


def test_triangles_that_cross_are_cut_where_they_cross(canvas):
    paint(canvas, SQUARE, 1.0, RED)
    tilted = np.where(SQUARE[..., 0] == 2.0, 0.5, 1.5)
    canvas.paint(SQUARE, tilted, np.broadcast_to(BLUE, (2, 3, 3)))
    np.testing.assert_array_equal(canvas.colors[5, 3], RED)
    np.testing.assert_array_equal(canvas.colors[5, 10], BLUE)


def test_colors_run_evenly_between_corners(canvas):
    canvas.paint(SQUARE, np.ones((2, 3)), np.where(SQUARE[..., :1] == 2.0, RED, BLUE))
    shares = (np.arange(2, 12) + 0.5 - 2.0) / 10.0
    np.testing.assert_allclose(canvas.colors[6, 2:12, 2], shares, atol=1e-6)


def test_only_the_foremost_layer_of_a_glaze_counts(canvas):
    doubled = np.concatenate([SQUARE, SQUARE])
    canvas.glaze(doubled, np.repeat([[1.0], [1.0], [2.0], [2.0]], 3, axis=1), np.broadcast_to(GREEN, (4, 3, 3)), alpha=0.5)
    np.testing.assert_allclose(canvas.colors[5, 5], 0.5 * GREEN)
    assert canvas.nearness[5, 5] == 0.0


@pytest.mark.parametrize(("nearness", "share"), [(2.0, 0.5), (0.5, 0.25)])
def test_a_glaze_is_fainter_behind_something(canvas, nearness, share):
    paint(canvas, SQUARE, 1.0, RED)
    paint(canvas, SQUARE, nearness, GREEN, alpha=0.5, hidden_alpha=0.25)
    np.testing.assert_allclose(canvas.colors[5, 5], (1.0 - share) * RED + share * GREEN)
