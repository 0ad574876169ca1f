"""Graphs of keypoints, found anew at every step: corners or ends, then what is bent and far from the others (eq. 21)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from maniskill_grpd.graphs import GraphSchema
from maniskill_grpd.graphs.displacement import displace
from maniskill_grpd.physics import Model, Solver
from maniskill_grpd.rendering.sensor_noise import draw_normal, draw_uniform
from maniskill_grpd.tasks.observation.partial_view import Nodes, like_nodes
from maniskill_grpd.tasks.options.keypoints import Keypoints

FLATNESS = 0.1
"""Weight of nodes where the object is not bent at all [rad]: among them, keypoints cover the object evenly."""
CORNER_WEIGHT = 1000.0
"""Weight of corners and ends, which come before all others."""
MOST_NEIGHBORS = 8
POSITION_STREAM, DROPOUT_STREAM = -1, -2
"""Streams of random numbers; cameras count theirs from 0 up."""


class KeypointView:
    """Shows k of the nodes of a graph.

    The next keypoint is the node with the largest product of its distance through the material to those before and of how much
    the object is bent around it. Two are neighbours where no third one is nearer to both of them (relative neighbourhood graph):
    along a rope each has the one before and the one after it.
    """

    def __init__(
        self,
        solver: Solver,
        nodes: list[np.ndarray],
        schema: GraphSchema,
        thinned: Callable[[torch.Tensor], torch.Tensor],
        keypoints: Keypoints,
        seeds: Callable[[int], torch.Tensor],
    ) -> None:
        """Set up tables of all variants.

        Args:
            solver: The worlds.
            nodes: Which nodes of each variant the graph has.
            schema: What the graph holds.
            thinned: Returns what the nodes of the graph have of values of all nodes.
            keypoints: How many are found, and how badly.
            seeds: Returns a seed for each world and step, (B,) int32, another one for another stream of random numbers.

        Raises:
            ValueError: If a graph has fewer nodes than there are keypoints.
        """
        fewest = min(map(len, nodes))
        if keypoints.num > fewest:
            raise ValueError(f"keypoints must be in [2, {fewest}], the nodes of the smallest graph, got {keypoints.num}")
        self._solver, self._schema, self._thinned, self._keypoints, self._seeds = solver, schema, thinned, keypoints, seeds
        size, device = max(map(len, nodes)), solver.device
        distances = np.zeros((len(nodes), size, size), np.float32)
        corners = np.zeros((len(nodes), size), bool)
        for index, (model, chosen) in enumerate(zip(solver.models, nodes, strict=True)):
            num = len(chosen)
            distances[index, :num, :num] = model.geodesic_distances(chosen)[chosen]
            corners[index, :num] = is_corner(model)[chosen]
        self._distances, self._corners = torch.as_tensor(distances, device=device), torch.as_tensor(corners, device=device)
        self._pieces = torch.as_tensor(_padded_pieces(solver.models), device=device)

    def show(self, nodes: Nodes, seen: torch.Tensor) -> Nodes:
        """Return the keypoints among the nodes in `seen` (B, n), with tensors (B, k, ...); the rest is masked."""
        variants = self._solver.variants.long()
        distances = self._distances[variants]
        bends = bend_angles(self._solver.positions, self._pieces[variants])
        weights = self._thinned(bends) + FLATNESS + CORNER_WEIGHT * self._corners[variants]
        chosen, found = choose_keypoints(weights, distances, nodes["mask"] & seen, self._keypoints.num)
        rows = torch.arange(len(chosen), device=chosen.device)[:, None]
        shown = {name: nodes[name][rows, chosen] for name in ("position", "vectors", "scalars")}
        shown, found = self._detected(shown, found)
        among = distances[rows[..., None], chosen[:, :, None], chosen[:, None]]
        kept = {name: value * like_nodes(found, value) for name, value in shown.items()}
        return {**kept, "mask": found, "neighbors": relative_neighbors(among, found)}

    def _detected(self, nodes: Nodes, found: torch.Tensor) -> tuple[Nodes, torch.Tensor]:
        """Return nodes as they are detected, and which of those found (B, k) are."""
        noise, dropout = self._keypoints.noise, self._keypoints.dropout
        if noise:
            shift = noise * draw_normal(self._seeds(POSITION_STREAM), *nodes["position"].shape[1:])
            nodes = displace(self._schema.object, nodes, shift)
        if dropout:
            found = found & (draw_uniform(self._seeds(DROPOUT_STREAM), found.shape[1]) >= dropout)
        return nodes, found


def is_corner(model: Model) -> np.ndarray:
    """Return which nodes are ends of a rope or corners of a cloth, (N,) bool."""
    return (model.arc == 0.0) | (model.arc == 1.0) if model.is_rope else model.arc == 0.0


def bend_angles(positions: torch.Tensor, pieces: torch.Tensor) -> torch.Tensor:
    """Return how far the directions of the pieces around each node are from their mean, (B, N) [rad]; 0 where it is straight.

    Args:
        positions: (B, N, 3) [m].
        pieces: Nodes of the segments of a rope (B, F, 2) or of the triangles of a cloth (B, F, 3); equal ones for no piece. The
            direction of a triangle is its normal.
    """
    rows = torch.arange(len(positions), device=positions.device)[:, None]
    first, *others = (positions[rows, pieces[..., corner]] for corner in range(pieces.shape[-1]))
    sides = [other - first for other in others]
    along = torch.linalg.cross(*sides) if len(sides) == 2 else sides[0]
    length = torch.linalg.vector_norm(along, dim=-1, keepdim=True)
    weighted = torch.cat([along / length.clamp(min=1e-12), (length > 0.0).to(along.dtype)], dim=-1)
    sums = positions.new_zeros(*positions.shape[:2], 4)
    for corner in range(pieces.shape[-1]):
        sums.scatter_add_(1, pieces[..., corner, None].expand(-1, -1, 4), weighted)
    mean = torch.linalg.vector_norm(sums[..., :3], dim=-1) / sums[..., 3].clamp(min=1.0)
    return torch.where(sums[..., 3] > 0.0, mean.clamp(max=1.0).arccos(), 0.0)


def choose_keypoints(
    weights: torch.Tensor, distances: torch.Tensor, allowed: torch.Tensor, num: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Choose nodes, each with the largest product of weight and distance to the nearest one before.

    Args:
        weights: (B, n), positive.
        distances: Between nodes, (B, n, n) [m].
        allowed: Nodes among which to choose, (B, n) bool.
        num: How many, k.

    Returns:
        Nodes (B, k) int64, and which of them are any: there may be fewer allowed ones, (B, k) bool.
    """
    rows = torch.arange(len(weights), device=weights.device)
    distance, nodes, found = torch.ones_like(weights), [], []
    for _ in range(num):
        best, node = torch.where(allowed, weights * distance, 0.0).max(dim=1)
        to_it = distances[rows, node]
        distance = torch.minimum(distance, to_it) if nodes else to_it
        nodes.append(node)
        found.append(best > 0.0)
    return torch.stack(nodes, dim=1), torch.stack(found, dim=1)


def relative_neighbors(distances: torch.Tensor, mask: torch.Tensor) -> torch.Tensor:
    """Return the relative neighbourhood graph of points at given distances, nearest neighbours first, (B, k, K) int64, -1 padded.

    Args:
        distances: (B, k, k).
        mask: Which points there are, (B, k) bool.
    """
    num = distances.shape[1]
    apart = distances.masked_fill(~(mask[:, :, None] & mask[:, None]), torch.inf)
    farther = torch.maximum(apart[:, :, :, None], apart[:, None])  # of i, m and j: m's larger distance to i and j
    is_between = (farther < apart[:, :, None]).any(dim=2)
    own = torch.eye(num, dtype=torch.bool, device=distances.device)
    nearest, order = apart.masked_fill(is_between | own, torch.inf).topk(min(num - 1, MOST_NEIGHBORS), largest=False, sorted=True)
    return torch.where(nearest < torch.inf, order, -1)


def _padded_pieces(models: tuple[Model, ...]) -> np.ndarray:
    """Return the segments or triangles of each variant, (M, F, 2 or 3) int64, filled up with such as have no length."""
    pieces = [_segments(model) if model.is_rope else model.faces for model in models]
    most = max(map(len, pieces))
    return np.stack([np.pad(each, ((0, most - len(each)), (0, 0))) for each in pieces]).astype(np.int64)


def _segments(model: Model) -> np.ndarray:
    return np.arange(model.num_nodes - 1)[:, None] + [0, 1]
