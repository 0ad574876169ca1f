"""Polygons: measures against closed forms, and what is refused as an outline."""

import numpy as np
import pytest

from maniskill_grpd.physics import circle_outline, cloth, l_shape_outline, square_outline
from maniskill_grpd.physics.mesh.outlines import centroid, check_holes, check_polygon, signed_area

SPIKE = [[0, 0], [2, 0], [2, 1], [3, 1], [2, 1.0], [0, 1]]
PINCHED = [[0, 0], [2, 0], [2, 2], [1, 0], [0, 2]]


def test_the_centroid_of_an_l_is_that_of_its_two_boxes():
    size = 0.3
    boxes = [(0.5 * size**2, np.array([0.5, 0.25])), (0.25 * size**2, np.array([0.25, 0.75]))]
    expected = size * (sum(area * middle for area, middle in boxes) / sum(area for area, _ in boxes) - 0.5)
    shift = np.array([5.0, -3.0])
    np.testing.assert_allclose(centroid(l_shape_outline(size) + shift), expected + shift, rtol=1e-12)
    np.testing.assert_allclose(centroid(l_shape_outline(size)[::-1]), expected, atol=1e-12)


def test_a_polygon_may_be_clockwise_closed_and_of_plain_lists():
    square = square_outline(0.4)
    for given in (square, square[::-1], [*square.tolist(), square[0].tolist()]):
        checked = check_polygon(given, "it")
        assert checked.shape == (4, 2)
        assert checked.dtype == np.float64
        assert {tuple(row) for row in checked} == {tuple(row) for row in square}
        assert signed_area(checked) == pytest.approx(0.16)  # positive: counter-clockwise


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((4, 3)), r"polygon \(P >= 3, 2\), got an array of shape \(4, 3\)"),
        (np.zeros(4), r"got an array of shape \(4,\)"),
        ([], r"polygon \(P >= 3, 2\)"),
        ([[0, 0], [1, 0], [0]], "rows of different lengths"),
        ([["a", "b"], ["c", "d"], ["e", "f"]], "of numbers, got"),
        ([[0, 0], [1, 0], [None, 1]], "of numbers, got"),
        (5, r"shape \(\)"),
        ([[0, 0], [1, 0], [np.inf, 1]], r"finite, got \[inf  ?1.\] in it"),
        ([[0, 0], [1, 0], [0, 0]], "got 2 points"),
        ([[0, 0], [1, 0], [2, 0]], "enclose an area, got 0"),
        ([[0, 0], [2, 1], [2, 0], [0, 1.5]], "edges 0 and 2 cross"),
        ([[0, 0], [1, 0], [1, 0], [0, 1]], "points 1 and 2 are the same"),
        (SPIKE, "points 2 and 4 are the same"),
        (PINCHED, "point 3 lies on edge 0"),
    ],
)
def test_what_is_no_simple_polygon_is_refused_by_what_is_wrong(points, message):
    with pytest.raises(ValueError, match=f"it must.*{message}"):
        check_polygon(points, "it")


def test_holes_that_touch_are_refused():
    square = square_outline(1.0)
    with pytest.raises(ValueError, match=r"hole 0 must lie inside.*\[0.1, 0.5\] m x \[-0.2, 0.2\] m"):
        check_holes(square, [square_outline(0.4) + [0.3, 0.0]])
    with pytest.raises(ValueError, match="holes 0 and 1 must not overlap or touch"):
        check_holes(square, [square_outline(0.2), square_outline(0.2) + [0.2, 0.0]])
    check_holes(square, [square_outline(0.2), square_outline(0.2) + [0.21, 0.0]])


@pytest.mark.parametrize("angle", [0.3, np.pi / 4])
def test_a_square_that_is_turned_out_of_the_axes_is_the_same_cloth(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    model = cloth(square_outline(0.24) @ turn.T, num_nodes=100)
    assert model.masses.sum() == pytest.approx(0.2 * 0.24**2, rel=1e-5)
    assert len(model.node_sets["corners"]) == 4
    bent = set(model.hinges.ravel()) | set(model.bends.ravel())
    assert bent == set(range(model.num_nodes))


@pytest.mark.parametrize("first_side", [0.01, 0.1])
def test_the_number_of_nodes_does_not_depend_on_which_side_comes_first(first_side):
    outline = np.array([[0.0, 0.0], [first_side, 0.0], [0.3, 0.24], [-0.1, 0.2]])
    sizes = [cloth(np.roll(outline, -turn, axis=0), num_nodes=100).num_nodes for turn in range(4)]
    assert max(abs(size - 100) for size in sizes) <= 15


def test_the_circle_touches_nothing_and_is_a_hole():
    check_holes(square_outline(0.4), [check_polygon(circle_outline(0.1), "it")])
