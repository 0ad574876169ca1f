"""Meshes that cannot be cloth are refused by name; vertices at the same place are sewn together."""

import numpy as np
import pytest

from maniskill_grpd.physics.mesh.sewing import sew

POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.5, 0.5, 1.0]])
SQUARE = [[0, 1, 2], [1, 3, 2]]


def with_point(index, value):
    points = POINTS[:4].copy()
    points[index] = value
    return points


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (POINTS[:, :2], SQUARE, r"vertices must be numbers \(V >= 1, 3\), got float64 of shape \(5, 2\)"),
        (with_point(2, [0.0, np.nan, 0.0]), SQUARE, r"vertices must be finite, vertex 2 is \[0.0, nan, 0.0\]"),
        (POINTS[:4], [[0, 1, 2, 3]], r"faces must be whole numbers \(F >= 1, 3\), got int64 of shape \(1, 4\)"),
        (POINTS[:4], np.array(SQUARE, dtype=float), "faces must be whole numbers"),
        (POINTS[:4], [[0, 1, 2], [1, 7, 2]], r"faces must index vertices 0 to 3, face 1 is \[1, 7, 2\]"),
        (POINTS[:4], [[0, 1, 2], [1, -1, 2]], r"face 1 is \[1, -1, 2\]"),
        (POINTS, SQUARE, "every vertex must belong to a face, to none belongs vertex 4"),
        (POINTS[:4], [[0, 1, 2], [1, 3, 3], [1, 3, 2]], "faces must have an area, none has face 1"),
        (with_point(3, [0.5, 0.5, 0.0]), SQUARE, "faces must have an area, none has face 1"),
        (POINTS[:4], [*SQUARE, [2, 0, 1]], r"faces must differ, faces 0, 2 have the same corners \[0, 1, 2\]"),
        (
            POINTS,
            [*SQUARE, [1, 2, 4]],
            "at most two faces may meet at an edge, faces 0, 1, 2 meet at the edge of vertices 1 and 2",
        ),
        (
            np.concatenate([POINTS[:4], POINTS[:4] + [3.0, 0.0, 0.0]]),
            [*SQUARE, [4, 5, 6], [5, 7, 6]],
            "a cloth must be of one piece, got 2; vertex 4 is not connected to vertex 0",
        ),
    ],
)
def test_what_cannot_be_cloth_is_refused_by_name(vertices, faces, message):
    with pytest.raises(ValueError, match=message):
        sew(vertices, faces)


def test_vertices_at_the_same_place_are_one_node():
    doubled = np.concatenate([POINTS[[3, 1, 2]], POINTS[[0, 2, 1]] + 1e-8])
    points, faces, node_of_vertex = sew(doubled, [[0, 2, 1], [3, 4, 5]])
    np.testing.assert_array_equal(node_of_vertex, [0, 1, 2, 3, 2, 1])
    np.testing.assert_array_equal(faces, [[0, 2, 1], [3, 2, 1]])
    np.testing.assert_allclose(points, POINTS[[3, 1, 2, 0]], atol=1e-7)
    apart = doubled.copy()
    apart[4] += 0.01
    with pytest.raises(ValueError, match="meet|piece"):
        sew(np.concatenate([apart[:3], apart[3:] + 0.01]), [[0, 2, 1], [3, 4, 5]])
