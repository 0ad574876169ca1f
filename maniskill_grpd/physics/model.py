"""The immutable description of a deformable object: geometry, masses and constraints."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra


@dataclass(frozen=True, kw_only=True)
class Model:
    """A deformable object with N nodes, in its rest shape.

    Compliances are inverse stiffnesses, so that the energy of a constraint is |C|^2 / (2 compliance). They already contain the
    mesh spacing: a builder turns material constants into them, and a finer mesh is the same material.
    """

    rest_positions: np.ndarray
    """Node positions of the rest shape, (N, 3) float32 [m]."""
    masses: np.ndarray
    """Node masses, (N,) float32 [kg]."""
    radius: float
    """Distance [m] that nodes keep from a surface: half the rope's thickness."""
    damping: float
    """Decay rate [1/s] of the velocity of free nodes (air drag)."""
    friction: float
    """Default coefficient of Coulomb friction against the table, dimensionless."""
    edges: np.ndarray
    """Edges of the chain in order, edge k joining nodes k and k + 1; each is a stretch constraint
    C = |x_k - x_k+1| - rest_length. (E, 2) int32."""
    rest_lengths: np.ndarray
    """Rest lengths of the edges, (E,) float32 [m]."""
    stretch_compliances: np.ndarray
    """Inverse spring constants of the edges, (E,) float32 [m/N]."""
    bends: np.ndarray
    """Node triples (previous, middle, next), each a bend constraint C = x_p - 2 x_m + x_n, (T, 3) int32."""
    bend_compliances: np.ndarray
    """Inverse stiffnesses of the bend constraints, (T,) float32 [m/N]."""
    arc: np.ndarray
    """Position of each node along the object, 0 at one end and 1 at the other, (N,) float32."""
    length: float
    """Total length [m]."""
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)
    """Named nodes, such as "ends", each an int64 array."""

    @property
    def num_nodes(self) -> int:
        """Number of nodes N."""
        return len(self.rest_positions)

    @property
    def neighbors(self) -> np.ndarray:
        """Nodes that share an edge with each node, (N, K) int64, padded with -1."""
        lists: list[list[int]] = [[] for _ in range(self.num_nodes)]
        for i, j in self.edges.tolist():
            lists[i].append(j)
            lists[j].append(i)
        width = max(len(nodes) for nodes in lists)
        return np.array([sorted(nodes) + [-1] * (width - len(nodes)) for nodes in lists], dtype=np.int64)

    def geodesic_distances(self, nodes: np.ndarray) -> np.ndarray:
        """Return the shortest way along the rest-shape edges from every node to given nodes (A,), as (N, A) float32 [m]."""
        i, j = self.edges.T
        graph = coo_matrix((self.rest_lengths, (i, j)), shape=(self.num_nodes, self.num_nodes))
        return dijkstra(graph, directed=False, indices=nodes).T.astype(np.float32)
