"""The shirt of examples/garment.py is sewn where it should be, and its counter of crossings counts."""

import numpy as np
import pytest

pytest.importorskip("mani_skill")

from examples.garment import count_crossings, sew_shirt
from maniskill_grpd.physics import cloth, square_outline


def test_a_shirt_has_two_layers_and_four_openings():
    shirt = sew_shirt(100)
    # A sphere with four holes: hem, neck and two sleeves.
    assert shirt.num_nodes - len(shirt.mesh_edges) + len(shirt.faces) == 2 - 4
    assert sum(name.startswith("loop_") for name in shirt.node_sets) == 4
    assert count_crossings(shirt, shirt.rest_positions.astype(np.float64)) == 0


def test_an_edge_through_a_triangle_is_counted():
    model = cloth(square_outline(0.2), num_nodes=36)
    positions = model.rest_positions.astype(np.float64)
    folded = positions.copy()
    folded[:, 0] = np.abs(folded[:, 0] - 0.013)
    folded[positions[:, 0] > 0.013, 2] = 0.006
    folded[:, 1] += 0.003 * (positions[:, 0] > 0.013)
    assert count_crossings(model, folded) == 0
    folded[np.argmax(positions[:, 0] - positions[:, 1]), 2] = -0.01  # a corner through the lower layer
    assert count_crossings(model, folded) > 0
