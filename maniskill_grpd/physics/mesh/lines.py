"""Edges of a mesh grouped into lines, the units of the stretch solve."""

from __future__ import annotations

import numpy as np

# Two edges that meet at a node go on as one line if they turn by less than this [rad].
MAX_TURN = np.deg2rad(35.0)


def group_into_lines(points: np.ndarray, edges: np.ndarray) -> list[np.ndarray]:
    """Join edges end to end, each with the one that continues it most nearly straight.

    The edges of a square grid become its rows, columns and diagonals; a rope is a single line. No line visits a node twice, and
    every edge belongs to exactly one.

    Args:
        points: Rest positions, (N, D) [m].
        edges: Node pairs, (E, 2) int.

    Returns:
        Nodes of each line in order, each (L >= 2,) int64, sorted by direction so that lines side by side follow each other.
    """
    continuation = _match_straightest(points, edges)
    unused = np.ones(len(edges), dtype=bool)
    lines = []
    ends = [edge for edge in range(len(edges)) if not all((edge, int(node)) in continuation for node in edges[edge])]
    for edge in [*ends, *range(len(edges))]:  # closed lines have no end and come last
        if unused[edge]:
            free_end = [int(node) for node in edges[edge] if (edge, int(node)) not in continuation]
            lines.append(_follow(edge, free_end[0] if free_end else int(edges[edge][0]), edges, continuation, unused))
    vectors = [points[line[1]] - points[line[0]] for line in lines]
    angles = [np.round(np.arctan2(v[1], v[0]) % np.pi % (np.pi - 1e-6), 3) for v in vectors]
    return [lines[index] for index in np.argsort(angles, kind="stable")]


def _match_straightest(points: np.ndarray, edges: np.ndarray) -> dict[tuple[int, int], int]:
    """Return the edge that continues an edge beyond a node, for keys (edge, node)."""
    at_node: dict[int, list[int]] = {}
    for edge, nodes in enumerate(edges.tolist()):
        for node in nodes:
            at_node.setdefault(node, []).append(edge)
    candidates = []
    for node, incident in at_node.items():
        far = np.array([edges[edge].sum() - node for edge in incident])
        away = points[far] - points[node]
        away = away / np.linalg.norm(away, axis=1, keepdims=True)
        cosine = -away @ away.T
        for i, j in np.argwhere(np.triu(cosine > np.cos(MAX_TURN), k=1)):
            candidates.append((-round(float(cosine[i, j]), 6), node, incident[i], incident[j]))
    continuation: dict[tuple[int, int], int] = {}
    for _, node, i, j in sorted(candidates):
        if (i, node) not in continuation and (j, node) not in continuation:
            continuation[i, node], continuation[j, node] = j, i
    return continuation


def _follow(edge: int, start: int, edges: np.ndarray, continuation: dict[tuple[int, int], int], unused: np.ndarray) -> np.ndarray:
    """Walk along a line from a node over an edge until it ends or would meet itself."""
    line = [start]
    while True:
        following = int(edges[edge].sum() - line[-1])
        if following in line:
            break
        unused[edge] = False
        line.append(following)
        edge = continuation.get((edge, following), -1)
        if edge < 0 or not unused[edge]:
            break
    return np.array(line, dtype=np.int64)
