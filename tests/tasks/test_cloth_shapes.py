"""Cloth shapes by name."""

import json

import numpy as np
import pytest

from maniskill_grpd.physics import cloth
from maniskill_grpd.tasks.geometry.cloth_shapes import (
    CLOTH_SHAPES,
    check_cloth_shapes,
    cloth_outline,
    in_cloth_frame,
    register_cloth_shape,
)

CORNERS = {"square": 4, "rectangle": 4, "triangle": 3, "hexagon": 6, "circle": 4, "l_shape": 6}


def area_of(polygon):
    x, y = polygon.T
    return 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)


@pytest.mark.parametrize("name", CLOTH_SHAPES)
def test_outlines_have_the_area_asked_for(name):
    # A polygon of 48 sides encloses 0.3 % less than its circle.
    assert area_of(cloth_outline(name, 0.16)) == pytest.approx(0.16, rel=1e-12 if name != "circle" else 4e-3)


@pytest.mark.parametrize("name", CLOTH_SHAPES)
def test_every_shape_becomes_a_cloth_with_its_corners(name):
    model = cloth(cloth_outline(name, 0.16), num_nodes=100)
    assert len(model.node_sets["corners"]) == CORNERS[name]
    assert model.masses.sum() == pytest.approx(0.2 * 0.16, rel=0.02)
    assert 80 <= model.num_nodes <= 130


def test_one_name_or_several_are_accepted_and_others_refused():
    assert check_cloth_shapes("square", 0.16) == ("square",)
    assert check_cloth_shapes(["hexagon", "circle"], 0.16) == ("hexagon", "circle")
    for wrong in ("star", [], ["square", "star"], None, 3, {"square": 1}):
        with pytest.raises(ValueError, match=r"must be among square, rectangle.*or polygons \(P >= 3, 2\) \[m\], got"):
            check_cloth_shapes(wrong, 0.16)
    with pytest.raises(ValueError, match="must be among"):
        cloth_outline("star", 0.16)


KITE = [[0.0, 0.0], [0.2, 0.25], [0.0, 0.4], [-0.2, 0.25]]


@pytest.mark.parametrize("given", [KITE, np.array(KITE), [KITE], np.array([KITE]), [np.array(KITE)], tuple(map(tuple, KITE))])
def test_polygons_come_as_lists_arrays_and_lists_of_those(given):
    assert check_cloth_shapes(given, 0.16) == (tuple(map(tuple, KITE)),)


def test_names_and_polygons_mix_and_are_plain():
    shapes = check_cloth_shapes(["square", np.array(KITE)], 0.16)
    assert json.loads(json.dumps(shapes)) == ["square", KITE]
    assert check_cloth_shapes(json.loads(json.dumps(shapes)), 0.16) == shapes


def test_a_polygon_keeps_its_size_and_is_moved_to_its_centroid():
    (kite,) = check_cloth_shapes(KITE, 0.16)
    outline = cloth_outline(kite, 0.16)
    assert area_of(outline) == pytest.approx(area_of(np.array(KITE)))
    # Two triangles of equal base and heights 0.25 m and 0.15 m: their centroids lie a third of each height from the base.
    middle = 0.25 + (0.15 * 0.05 - 0.25 * 0.25 / 3) / 0.4
    np.testing.assert_allclose(outline, np.array(KITE) - [0.0, middle], atol=1e-12)
    np.testing.assert_allclose(in_cloth_frame(kite, np.array([[0.0, middle]])), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([KITE, [[0, 0], [1, 1], [1, 0], [0, 1.2]]], r"shapes\[1\] must not intersect itself"),
        (np.zeros((2, 4, 3)), r"shapes\[0\] must be a polygon \(P >= 3, 2\), got an array of shape \(4, 3\)"),
        ([1.0, 2.0], r"shapes\[0\] must be a polygon.*shape \(\)"),
        ([[0.0, 0.0], [1.0, 0.0], [0.0]], r"shapes\[0\].*rows of different lengths"),
        ((100 * np.array(KITE)).tolist(), r"0.05 to 0.36 m.*got 21.* polygon of 4 points; coordinates are in metres"),
    ],
)
def test_polygons_that_are_none_are_refused(given, message):
    with pytest.raises(ValueError, match=message):
        check_cloth_shapes(given, 0.16)


def test_a_shape_that_is_registered_has_the_area_asked_for(monkeypatch):
    monkeypatch.setattr(CLOTH_SHAPES, "_shapes", dict(CLOTH_SHAPES))
    register_cloth_shape("kite", 30.0 * np.array(KITE)[::-1])
    register_cloth_shape("kite again", lambda: KITE)
    outline = cloth_outline("kite", 0.16)
    assert area_of(outline) == pytest.approx(0.16)
    assert check_cloth_shapes(["kite", "square"], 0.16) == ("kite", "square")
    np.testing.assert_allclose(sorted(outline.tolist()), sorted(cloth_outline("kite again", 0.16).tolist()), atol=1e-12)
    with pytest.raises(ValueError, match="already one of the shapes of cloth with the name 'square'"):
        register_cloth_shape("square", KITE)
    with pytest.raises(ValueError, match="the name of a shape.*got ''"):
        register_cloth_shape("", KITE)
    with pytest.raises(ValueError, match="the shape 'line' must enclose an area"):
        register_cloth_shape("line", [[0, 0], [1, 0], [2, 0]])
    assert "line" not in CLOTH_SHAPES
