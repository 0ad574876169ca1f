"""Choice of the nodes that a policy sees."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from maniskill_grpd.physics import circle_outline, cloth, rope, square_outline
from maniskill_grpd.tasks.observation.graph_nodes import choose_graph_nodes, neighbors_among

MODEL = rope(np.array([[0.0, 0.0], [1.0, 0.0]]), num_nodes=41)
HELD = np.array([0, 10, 30, 40])


def test_all_nodes_keep_the_mesh():
    nodes = choose_graph_nodes(MODEL, None, HELD)
    assert nodes.tolist() == list(range(41))
    np.testing.assert_array_equal(neighbors_among(MODEL, nodes), MODEL.neighbors)


def covering_radius(nodes):
    """Return the largest distance of any of the 41 nodes of the rope from the nearest chosen one, in edges."""
    return np.abs(np.arange(41)[:, None] - nodes).min(axis=1).max()


def optimal_radius(num):
    """Return the smallest covering radius of `num` nodes that contain the held ones, in edges.

    A stretch of g edges between two held nodes is covered with radius r by ceil((g - 2 r - 1) / (2 r + 1)) nodes within it:
    its ends cover r inner nodes each, every other one 2 r + 1.
    """
    gaps = np.diff(HELD)
    needed = [len(HELD) + sum(max(0, math.ceil((gap - 1 - 2 * r) / (2 * r + 1))) for gap in gaps) for r in range(41)]
    return next(r for r in range(41) if needed[r] <= num)


def test_the_optimal_radius_is_that_of_brute_force():
    for num in (4, 5, 6):
        choices = combinations(sorted(set(range(41)) - set(HELD)), num - 4)
        assert optimal_radius(num) == min(covering_radius(np.array([*HELD, *more])) for more in choices)


@given(st.integers(4, 41))
def test_chosen_nodes_cover_the_rope_and_contain_the_held_ones(num):
    nodes = choose_graph_nodes(MODEL, num, HELD)
    assert len(set(nodes.tolist())) == num
    assert set(HELD) <= set(nodes.tolist())
    # No other choice that contains the held nodes covers the rope with less than half the radius.
    assert covering_radius(nodes) <= 2 * optimal_radius(num)


@given(st.integers(4, 40))
def test_chosen_nodes_are_joined_to_a_chain(num):
    neighbors = neighbors_among(MODEL, choose_graph_nodes(MODEL, num, HELD))
    assert neighbors.shape == (num, 2)
    joined = [sorted(set(row.tolist()) - {-1}) for row in neighbors]
    assert joined == [[j for j in (i - 1, i + 1) if 0 <= j < num] for i in range(num)]


@pytest.mark.parametrize("num", [12, 30, 80])
def test_chosen_nodes_of_a_cloth_are_joined_to_a_connected_mesh(num):
    sheet = cloth(square_outline(0.4), holes=[circle_outline(0.06)], num_nodes=100)
    nodes = choose_graph_nodes(sheet, num, sheet.node_sets["corners"])
    neighbors = neighbors_among(sheet, nodes)
    first, column = np.nonzero(neighbors >= 0)
    second = neighbors[first, column]
    pairs = set(zip(first.tolist(), second.tolist(), strict=True))
    assert pairs == {(j, i) for i, j in pairs}
    assert all(i != j for i, j in pairs)
    reached = connected_components(coo_matrix((np.ones(len(first)), (first, second)), shape=(num, num)))[0]
    assert reached == 1
    # what is joined is close: no edge spans the hole
    spans = np.linalg.norm(sheet.rest_positions[nodes[first]] - sheet.rest_positions[nodes[second]], axis=1)
    assert spans.max() < 3.0 * np.sqrt(0.16 / num)


@pytest.mark.parametrize("num", [-1, 0, 3, 42])
def test_impossible_numbers_are_refused(num):
    with pytest.raises(ValueError, match=rf"graph_nodes must be in \[4, 41\].*got {num}"):
        choose_graph_nodes(MODEL, num, HELD)
