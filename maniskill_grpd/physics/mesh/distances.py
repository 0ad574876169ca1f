"""Shortest ways through a sheet: exact in a flat one with holes and concave corners, along the mesh on a curved surface."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra, shortest_path

from maniskill_grpd.physics.mesh.outlines import segments_cross, signed_area
from maniskill_grpd.physics.mesh.surface import Surface

STRAIGHT = 1e-6


def distances_in_sheet(points: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
    """Return the length of the shortest way through a sheet between all nodes, (N, N) float64 [m].

    Where the straight line between two nodes stays inside, that is their distance; otherwise the shortest way bends around
    nodes at concave places of the boundary.

    Args:
        points: Nodes of the sheet, (N, 2) [m].
        loops: Nodes of the outline, counter-clockwise, and of the holes in either direction, each in order.
    """
    distances = np.linalg.norm(points[:, None] - points[None], axis=-1)
    holes = [loop[::-1] if signed_area(points[loop]) > 0.0 else loop for loop in loops[1:]]
    sides = [_without_straight_nodes(points, loop) for loop in (loops[0], *holes)]  # the sheet lies to the left of all
    turning = np.concatenate([loop[_turns(points[loop]) < 0.0] for loop in sides])
    if len(turning) == 0:
        return distances
    distances[_hidden_pairs(points, sides)] = np.inf
    among = distances[np.ix_(turning, turning)]
    between = shortest_path(np.where(np.isinf(among), 0.0, among), directed=False)
    to_turning = (distances[:, turning, None] + between[None]).min(axis=1)
    from_turning = distances[turning].copy()
    for to_corner, from_corner in zip(to_turning.T, from_turning, strict=True):
        np.minimum(distances, to_corner[:, None] + from_corner[None], out=distances)
    return distances


def distances_on_surface(surface: Surface) -> np.ndarray:
    """Return the length of the shortest way along edges, and straight across pairs of unfolded triangles, (N, N) float64 [m].

    It is never shorter than the shortest way on the surface. On equilateral triangles it turns in steps of 30 degrees, which
    makes it longer by at most 1 / cos(15 degrees), 3.5 %; on right-angled ones by at most 8.2 %, the diagonals of whose
    squares lean one way.
    """
    corners = surface.unfold(surface.pair_nodes, surface.pair_faces[:, 0])
    is_crossing = segments_cross(corners[:, 0], corners[:, 1], corners[:, 2], corners[:, 3])
    ends = np.concatenate([surface.edges, surface.pair_nodes[is_crossing, 2:]])
    along = np.linalg.norm(surface.points[surface.edges[:, 1]] - surface.points[surface.edges[:, 0]], axis=1)
    across = np.linalg.norm(corners[is_crossing, 3] - corners[is_crossing, 2], axis=1)
    lengths = np.concatenate([along, across])
    # The same two nodes may be joined twice, by an edge and across another one: the sparse matrix would add the two up.
    order = np.lexsort((lengths, *np.sort(ends, axis=1).T))
    ends, lengths = np.sort(ends, axis=1)[order], lengths[order]
    is_first = np.concatenate([[True], (np.diff(ends, axis=0) != 0).any(axis=1)])
    graph = coo_matrix((lengths[is_first], tuple(ends[is_first].T)), shape=(len(surface.points), len(surface.points)))
    return dijkstra(graph, directed=False)


def _turns(polygon: np.ndarray) -> np.ndarray:
    """Return the sine of the turn at each vertex of a polygon (P, 2), positive to the left, zero where it is straight."""
    forward = np.roll(polygon, -1, axis=0) - polygon
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    backward = np.roll(forward, 1, axis=0)
    turn = backward[:, 0] * forward[:, 1] - backward[:, 1] * forward[:, 0]
    return np.where(np.abs(turn) < STRAIGHT, 0.0, turn)


def _without_straight_nodes(points: np.ndarray, loop: np.ndarray) -> np.ndarray:
    return loop[_turns(points[loop]) != 0.0]


def _hidden_pairs(points: np.ndarray, sides: list[np.ndarray]) -> np.ndarray:
    """Return which pairs of nodes do not see each other within the sheet, (N, N) bool."""
    hidden = np.zeros((len(points), len(points)), dtype=bool)
    size = np.ptp(points, axis=0).max()
    for loop in sides:
        for start, end in zip(loop, np.roll(loop, -1), strict=True):
            a, b = points[start], points[end]
            left_of_side = (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0])
            if left_of_side.min() < -STRAIGHT * size**2:  # else a side of the convex hull, which hides nothing
                hidden |= segments_cross(points[:, None], points[None], a, b)
        turns = _turns(points[loop])
        for index in range(len(loop)):
            behind = _behind_corner(points, turns[index] > 0.0, *loop[[index - 1, index, (index + 1) % len(loop)]])
            hidden[loop[index]] |= behind
            hidden[:, loop[index]] |= behind
    return hidden


def _behind_corner(points: np.ndarray, is_convex: bool, previous: int, corner: int, following: int) -> np.ndarray:
    """Return which nodes a corner sees only through the outside, (N,) bool.

    At a concave corner they are those in the cone between its two sides, at a convex one those in no such cone: tips of a zigzag
    rim, which lie on a line, do not see each other.
    """
    a, b = points[previous] - points[corner], points[following] - points[corner]
    rays = points - points[corner]
    span = a[0] * b[1] - a[1] * b[0]
    s = (rays[:, 0] * b[1] - rays[:, 1] * b[0]) / span
    t = (a[0] * rays[:, 1] - a[1] * rays[:, 0]) / span
    if is_convex:
        return (s < -STRAIGHT) | (t < -STRAIGHT)
    return (s > STRAIGHT) & (t > STRAIGHT)
