"""Where cloths come onto hangers and where they are held."""

import numpy as np
import pytest

from maniskill_grpd.physics import circle_outline, cloth, hexagon_outline, rectangle_outline, square_outline, triangle_outline
from maniskill_grpd.physics.mesh.outlines import distance_to
from maniskill_grpd.tasks.geometry.cloth_seat import check_middle, hole_outline, ring_about_middle, spread_corners
from maniskill_grpd.tasks.geometry.cloth_shapes import CLOTH_SHAPES, cloth_outline

INNER_RADII = {  # of outlines of 1 m^2
    "square": 0.5,
    "rectangle": 0.5 * np.sqrt(2 / 3),
    "triangle": 1 / 27**0.25,
    "hexagon": 0.5 * np.sqrt(2) * 3**-0.25,
    "circle": 1 / np.sqrt(np.pi),
    # The circle touches the outer sides and the inner corner: r = (a / 2) sqrt(2) / (1 + sqrt(2)) with a^2 = 4/3.
    "l_shape": np.sqrt(1 / 3) * np.sqrt(2) / (1 + np.sqrt(2)),
}


@pytest.mark.parametrize("name", CLOTH_SHAPES)
def test_holes_are_where_the_cloth_is_widest(name):
    outline, hole = cloth_outline(name, 0.16), hole_outline(name, 0.16, 0.06)
    room = distance_to(outline, hole.mean(axis=0)[None])[0]
    assert room == pytest.approx(0.4 * INNER_RADII[name], abs=0.003)  # searched in steps of 2.5 mm
    assert distance_to(outline, hole).min() == pytest.approx(room - 0.06, abs=0.001)
    if name != "l_shape":
        np.testing.assert_allclose(hole.mean(axis=0), 0.0, atol=1e-9)


def test_holes_that_do_not_fit_are_refused_with_the_largest_that_does():
    hole_outline("square", 0.16, 0.1)
    with pytest.raises(ValueError, match=r"must be in \[0.03, 0.1\] m.*got 0.5"):
        hole_outline("square", 0.16, 0.5)
    with pytest.raises(ValueError, match=r"so that a peg passes.*got 0.01"):
        hole_outline("square", 0.16, 0.01)
    with pytest.raises(ValueError, match=r"at most 0\.05\d m in a square of 0.03 m\^2, got 0.08"):
        hole_outline("square", 0.03, 0.08)


def test_a_hole_is_where_it_is_asked_for_in_the_coordinates_of_the_outline():
    np.testing.assert_allclose(hole_outline("square", 0.16, 0.06, (0.05, -0.1)).mean(axis=0), [0.05, -0.1], atol=1e-12)
    corner_at_origin = tuple(map(tuple, square_outline(0.4) + 0.2))
    np.testing.assert_allclose(hole_outline(corner_at_origin, 0.16, 0.06, (0.25, 0.1)).mean(axis=0), [0.05, -0.1], atol=1e-12)
    for outside in ((0.15, 0.0), (0.3, 0.0)):
        with pytest.raises(ValueError, match=r"hole_center must be hole_radius \+ 0.03 m = 0.09 m or more inside.*a square, got"):
            hole_outline("square", 0.16, 0.06, outside)
    for wrong in ((1, 2, 3), 0.1, "ab", [[0, 0], [1]], (np.nan, 0.0)):
        with pytest.raises(ValueError, match="hole_center must be"):
            hole_outline("square", 0.16, 0.06, wrong)


def test_a_cloth_whose_middle_is_not_in_it_cannot_lie_on_a_bar():
    for name in CLOTH_SHAPES:
        check_middle(name, 0.16)
    u_shape = ((0.0, 0.0), (0.4, 0.0), (0.4, 0.4), (0.3, 0.4), (0.3, 0.08), (0.1, 0.08), (0.1, 0.4), (0.0, 0.4))
    with pytest.raises(ValueError, match="0.05 m or more inside its outline, got 0 m for the polygon of 8 points"):
        check_middle(u_shape, 0.16)


@pytest.mark.parametrize(
    ("outline", "num", "expected"),
    [
        (square_outline(0.4), 4, [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]),
        (rectangle_outline(0.6, 0.4), 4, [[-0.3, -0.2], [0.3, -0.2], [0.3, 0.2], [-0.3, 0.2]]),
        (hexagon_outline(0.2), 3, 0.2 * np.array([[-0.5, -(0.75**0.5)], [1.0, 0.0], [-0.5, 0.75**0.5]])),
        (circle_outline(0.2), 4, [[0.2, 0.0], [0.0, 0.2], [-0.2, 0.0], [0.0, -0.2]]),
    ],
)
def test_grippers_spread_over_the_corners_in_their_order(outline, num, expected):
    model = cloth(outline, num_nodes=100)
    corners = model.rest_positions[spread_corners(model, num), :2]
    np.testing.assert_allclose(corners, expected, atol=0.025)  # half an edge of the mesh


def test_four_grippers_hold_a_hexagon_by_a_rectangle():
    model = cloth(hexagon_outline(0.2), num_nodes=100)
    points = model.rest_positions[spread_corners(model, 4), :2]
    sides = np.linalg.norm(np.roll(points, -1, axis=0) - points, axis=1)
    np.testing.assert_allclose(sides[:2], sides[2:], rtol=1e-5)
    assert sorted(sides / 0.2)[::2] == pytest.approx([1.0, 3**0.5])


def test_more_grippers_than_corners_are_refused():
    with pytest.raises(ValueError, match="one with 3 corners cannot take num_grippers=4"):
        spread_corners(cloth(triangle_outline(0.6), num_nodes=100), 4)


@pytest.mark.parametrize("num_nodes", [49, 100, 400])
def test_the_ring_surrounds_the_middle_once(num_nodes):
    model = cloth(square_outline(0.4), num_nodes=num_nodes)
    ring = ring_about_middle(model)
    points = model.rest_positions[ring, :2].astype(np.float64)
    assert len(set(ring.tolist())) == len(ring) >= 4
    np.testing.assert_allclose(points.mean(axis=0), 0.0, atol=0.006)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 0.05, atol=0.75 * 0.4 / (num_nodes**0.5 - 1))  # edges
    turns = np.diff(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))
    assert (turns > 0).all()
    assert turns.sum() < 2 * np.pi
