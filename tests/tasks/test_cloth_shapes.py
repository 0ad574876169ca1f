"""Cloth shapes by name."""

import numpy as np
import pytest

from maniskill_grpd.physics import cloth
from maniskill_grpd.tasks.geometry.cloth_shapes import CLOTH_SHAPES, check_cloth_shapes, cloth_outline

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
    assert check_cloth_shapes("square") == ("square",)
    assert check_cloth_shapes(["hexagon", "circle"]) == ("hexagon", "circle")
    for wrong in ("star", [], ["square", "star"]):
        with pytest.raises(ValueError, match="must be among square, rectangle.*got"):
            check_cloth_shapes(wrong)
    with pytest.raises(ValueError, match="must be among"):
        cloth_outline("star", 0.16)
