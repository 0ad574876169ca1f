"""Goal curves fit the rope exactly."""

import numpy as np
import pytest

from maniskill_grpd.tasks import GOAL_SHAPES, goal_curve, register_goal_shape

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
    with pytest.raises(ValueError, match=r"goal shapes must be among W, V, U, S, L, O, spiral, or curves.*got 'X'"):
        goal_curve("X", LENGTH, 41)


ZIGZAG = ((0.0, 0.0), (1.0, 1.0), (2.0, 0.0), (3.0, 1.0))


def test_an_own_curve_is_scaled_to_the_rope_whatever_its_size():
    curve = goal_curve(ZIGZAG, LENGTH, 41)
    np.testing.assert_allclose(np.linalg.norm(np.diff(curve, axis=0), axis=1), LENGTH / 40, rtol=1e-5)
    np.testing.assert_allclose(goal_curve(0.01 * np.array(ZIGZAG), LENGTH, 41), curve, atol=1e-9)
    turns = np.diff(np.unwrap(np.arctan2(*np.diff(curve, axis=0).T[::-1])))
    assert np.degrees(turns.sum()) == pytest.approx(0.0, abs=1.0)
    assert np.degrees(np.abs(turns).sum()) == pytest.approx(180.0, abs=1.0)  # a quarter turn at each of the two corners


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([[0.0, 0.0], [0.0, 0.0]], "a curve .P >= 2, 2. that has a length, got 2 points with a way of 0 m"),
        ([[0.0, 0.0]], "has a length, got 1 points"),
        (np.zeros((5, 3)), r"shape \(5, 3\)"),
        ([[0.0, 0.0], [np.nan, 1.0]], "finite"),
        ([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]], "turns back on itself within a segment"),
    ],
)
def test_curves_that_are_none_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        goal_curve(given, LENGTH, 40)


def test_a_curve_is_registered_once(monkeypatch):
    monkeypatch.setattr(GOAL_SHAPES, "_shapes", dict(GOAL_SHAPES))
    register_goal_shape("zigzag", lambda: ZIGZAG)
    np.testing.assert_array_equal(goal_curve("zigzag", LENGTH, 41), goal_curve(ZIGZAG, LENGTH, 41))
    with pytest.raises(ValueError, match="already one of the goal shapes with the name 'zigzag'"):
        register_goal_shape("zigzag", ZIGZAG)
