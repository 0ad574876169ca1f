"""Choice of the object nodes that a policy sees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maniskill_grpd.physics import Model


def choose_graph_nodes(model: Model, num: int | None, keep: np.ndarray) -> np.ndarray:
    """Choose nodes that cover the rest shape evenly, by farthest-point sampling.

    Args:
        model: The object, N nodes.
        num: Number of nodes to choose, or None for all.
        keep: Nodes that are always among them, (G,): those held by grippers.

    Returns:
        Chosen nodes in ascending order, (num,) int64.

    Raises:
        ValueError: If `num` is not between the number of nodes to keep (at least 2) and N.
    """
    if num is None:
        return np.arange(model.num_nodes)
    kept = np.unique(keep)
    fewest = max(2, len(kept))
    if not fewest <= num <= model.num_nodes:
        raise ValueError(
            f"graph_nodes must be in [{fewest}, {model.num_nodes}] (from the nodes that grippers "
            f"hold to all nodes of the object), got {num}"
        )
    return np.sort(_sample_farthest(model.rest_positions.astype(np.float64), num, kept))


def neighbors_among(model: Model, nodes: np.ndarray) -> np.ndarray:
    """Return the neighbours of chosen nodes, as indices into `nodes` (n,), (n, K) int64, -1 padded.

    All nodes of the object keep the mesh's neighbours. Of fewer nodes each stands for those of the
    object that are closest to it through the material; two are neighbours where an edge of the mesh
    joins what they stand for.
    """
    if len(nodes) == model.num_nodes:
        return model.neighbors
    owner = model.geodesic_distances(nodes).argmin(axis=1)
    edges = model.surface_edges
    pairs = np.unique(np.sort(owner[edges], axis=1), axis=0)
    lists: list[list[int]] = [[] for _ in nodes]
    for i, j in pairs[pairs[:, 0] != pairs[:, 1]].tolist():
        lists[i].append(j)
        lists[j].append(i)
    width = max(1, *(len(entry) for entry in lists))
    return np.array([sorted(entry) + [-1] * (width - len(entry)) for entry in lists], dtype=np.int64)


def mean_spacing(models: Sequence[Model], nodes: Sequence[np.ndarray], neighbors: Sequence[np.ndarray]) -> float:
    """Return the mean of `spacing_among` over variants [m]."""
    return float(np.mean([spacing_among(*entry) for entry in zip(models, nodes, neighbors, strict=True)]))


def spacing_among(model: Model, nodes: np.ndarray, neighbors: np.ndarray) -> float:
    """Return the mean distance in the rest shape between chosen nodes (n,) and their neighbours (n, K) [m]."""
    points = model.rest_positions[nodes].astype(np.float64)
    first, column = np.nonzero(neighbors >= 0)
    return float(np.linalg.norm(points[first] - points[neighbors[first, column]], axis=1).mean())


def _sample_farthest(points: np.ndarray, num: int, start: np.ndarray) -> np.ndarray:
    """Extend `start` to `num` indices, each the point (N, 3) that is farthest from those before."""
    chosen = list(start) or [0]
    distance = np.linalg.norm(points[:, None] - points[chosen], axis=-1).min(axis=1)
    while len(chosen) < num:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=-1))
    return np.array(chosen, dtype=np.int64)
