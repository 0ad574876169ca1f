"""Greedy colouring of constraints: two constraints of one colour share no node.

Constraints of one colour can be projected in any order, or at once, with the same result. This is what makes the Gauss-Seidel
sweep of the solver deterministic and race-free on a GPU.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def color_constraints(constraints: np.ndarray | Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Sort constraints by colour.

    Args:
        constraints: Node indices of each constraint, (C, k) int or C arrays of any length.

    Returns:
        order: Permutation of the constraints that puts equal colours side by side, (C,) int64; stable within a colour.
        offsets: Start of each colour in that order, closed by C: (num_colors + 1,) int32.
    """
    num_nodes = 1 + max((int(nodes.max()) for nodes in constraints), default=-1)
    used: list[set[int]] = [set() for _ in range(num_nodes)]
    colors = np.zeros(len(constraints), dtype=np.int64)
    for index, nodes in enumerate(constraints):
        taken = set().union(*(used[node] for node in nodes))
        color = next(c for c in range(len(taken) + 1) if c not in taken)
        colors[index] = color
        for node in nodes:
            used[node].add(color)
    order = np.argsort(colors, kind="stable")
    counts = np.bincount(colors) if len(colors) else np.zeros(0, dtype=np.int64)
    return order, np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
