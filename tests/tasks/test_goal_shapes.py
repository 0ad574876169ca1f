"""Goal curves fit the rope exactly."""

import numpy as np
import pytest

from maniskill_grpd.tasks import GOAL_SHAPES, goal_curve

LENGTH = 0.8


@pytest.mark.parametrize("num_nodes", [20, 41, 50, 200])
@pytest.mark.parametrize("name", GOAL_SHAPES)
def test_neighbours_are_one_rope_segment_apart(name, num_nodes):
    curve = goal_curve(name, LENGTH, num_nodes)
    chords = np.linalg.norm(np.diff(curve, axis=0), axis=1)
    assert curve.shape == (num_nodes, 2)
    np.testing.assert_allclose(chords, LENGTH / (num_nodes - 1), rtol=1e-5)
    assert chords.sum() == pytest.approx(LENGTH, rel=1e-12)
    np.testing.assert_allclose(curve.mean(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", GOAL_SHAPES)
def test_shape_does_not_depend_on_the_resolution(name):
    coarse, fine = goal_curve(name, LENGTH, 41), goal_curve(name, LENGTH, 161)
    np.testing.assert_allclose(fine[::4], coarse, atol=0.012)


@pytest.mark.parametrize("name", GOAL_SHAPES)
def test_rope_does_not_lie_on_itself(name):
    curve = goal_curve(name, LENGTH, 41)
    distances = np.linalg.norm(curve[:, None] - curve, axis=-1)
    far_along = np.abs(np.arange(41)[:, None] - np.arange(41)) > 3
    assert distances[far_along].min() > 0.02  # twice the radius of the rope


def test_w_has_four_equal_strokes_at_55_degrees_from_its_base_line():
    curve = goal_curve("W", LENGTH, 41)
    corners = curve[::10]
    strokes = np.diff(corners, axis=0)
    base = (corners[-1] - corners[0]) / np.linalg.norm(corners[-1] - corners[0])
    angles = np.degrees(np.arccos(strokes @ base / np.linalg.norm(strokes, axis=1)))
    np.testing.assert_allclose(angles, 55.0, atol=0.1)
    np.testing.assert_allclose(np.linalg.norm(strokes, axis=1), LENGTH / 4, rtol=1e-3)
    assert np.sign(strokes[:, 1]).tolist() == [-1, 1, -1, 1]


def test_unknown_shape_is_refused_with_the_allowed_ones():
    with pytest.raises(ValueError, match="unknown goal shape 'X'; allowed are W, V, U, S, L, O, spiral"):
        goal_curve("X", LENGTH, 41)
