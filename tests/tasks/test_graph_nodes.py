"""Choice of the nodes that a policy sees."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maniskill_grpd.physics import rope
from maniskill_grpd.tasks.graph_nodes import choose_graph_nodes, neighbors_among

MODEL = rope(np.array([[0.0, 0.0], [1.0, 0.0]]), num_nodes=41)
HELD = np.array([0, 10, 30, 40])


def test_all_nodes_keep_the_mesh():
    nodes = choose_graph_nodes(MODEL, None, HELD)
    assert nodes.tolist() == list(range(41))
    np.testing.assert_array_equal(neighbors_among(MODEL, nodes), MODEL.neighbors)


@given(st.integers(4, 41))
def test_chosen_nodes_cover_the_rope_and_contain_the_held_ones(num):
    nodes = choose_graph_nodes(MODEL, num, HELD)
    assert len(set(nodes.tolist())) == num
    assert set(HELD) <= set(nodes.tolist())
    # farthest-point sampling of a line leaves no gap of more than twice the even one
    assert np.diff(nodes).max() <= max(20, 2 * 40 / (num - 1)) + 1


@given(st.integers(4, 40))
def test_chosen_nodes_are_joined_to_a_chain(num):
    neighbors = neighbors_among(MODEL, choose_graph_nodes(MODEL, num, HELD))
    assert neighbors.shape == (num, 2)
    assert neighbors[:, 0].tolist() == [-1, *range(num - 1)]
    assert neighbors[:, 1].tolist() == [*range(1, num), -1]


@pytest.mark.parametrize("num", [-1, 0, 3, 42])
def test_impossible_numbers_are_refused(num):
    with pytest.raises(ValueError, match=rf"graph_nodes must be in \[4, 41\].*got {num}"):
        choose_graph_nodes(MODEL, num, HELD)
