"""The immutable description of a deformable object: geometry, masses and constraints."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from maniskill_grpd.physics.mesh.lines import group_into_lines


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
    """Node pairs, each a stretch constraint C = |x_i - x_j| - rest_length, (E, 2) int32. Edge k of a rope joins nodes k and
    k + 1."""
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
    faces: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.int32))
    """Triangles of a cloth, counter-clockwise in its rest shape, (F, 3) int32; none for a rope."""
    mesh_edges: np.ndarray | None = None
    """Edges of the triangles, (E', 2) int32, for a cloth whose `edges` also hold springs across; None where they are the same."""
    hinges: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.int32))
    """Two nodes of an edge and the two opposite it, each a bend constraint C = sum_k weight_k x_k, (H, 4) int32. On a rope whose
    segments differ: previous, middle, next and again the previous node, without weight."""
    hinge_weights: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.float32))
    """Weights of the hinges, dimensionless; C vanishes for every affine image of the rest shape. (H, 4) float32."""
    hinge_compliances: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """Inverse stiffnesses of the hinges, (H,) float32 [m/N]."""
    folds: np.ndarray = field(default_factory=lambda: np.zeros((0, 4), np.int32))
    """Nodes as of hinges whose two triangles are folded at rest, each a bend constraint C = sin(theta / 2) - sin(theta_0 / 2) on
    the angle theta between them, (D, 4) int32."""
    fold_sines: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """sin(theta_0 / 2) of the folds, positive towards the normals, (D,) float32."""
    fold_compliances: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    """Inverse stiffnesses of the folds, (D,) float32 [1/(N m)]."""
    max_strain: float = np.inf
    """Strain at which the weave locks: held nodes keep all others within (1 + max_strain) of their distance through the cloth."""
    wrinkle_strain: float = np.inf
    """Compression beyond which edges give way, because the material folds more finely than the mesh; infinity for a rope."""
    geodesics: np.ndarray | None = None
    """Distances through the material, (N, N) float32 [m]; None where edges alone define them."""
    default_substeps: int = 20
    """Substeps per control step of 0.05 s at which the object is stiff enough for a gripper at full speed."""

    @property
    def num_nodes(self) -> int:
        """Number of nodes N."""
        return len(self.rest_positions)

    @property
    def is_rope(self) -> bool:
        """Whether the object is a line of nodes rather than a sheet of triangles."""
        return len(self.faces) == 0

    @property
    def surface_edges(self) -> np.ndarray:
        """Edges that one sees and touches, without springs across triangles, (E', 2) int32."""
        return self.edges if self.mesh_edges is None else self.mesh_edges

    @property
    def neighbors(self) -> np.ndarray:
        """Nodes that share an edge with each node, (N, K) int64, padded with -1."""
        lists: list[list[int]] = [[] for _ in range(self.num_nodes)]
        for i, j in self.surface_edges.tolist():
            lists[i].append(j)
            lists[j].append(i)
        width = max(len(nodes) for nodes in lists)
        return np.array([sorted(nodes) + [-1] * (width - len(nodes)) for nodes in lists], dtype=np.int64)

    @cached_property
    def lines(self) -> list[np.ndarray]:
        """Nodes of the lines into which the edges are grouped, each solved at once; a rope is a single line in its own order."""
        nodes = np.arange(self.num_nodes)
        if np.array_equal(self.edges, np.stack([nodes[:-1], nodes[1:]], axis=1)):
            return [nodes]
        return group_into_lines(self.rest_positions.astype(np.float64), self.edges)

    def geodesic_distances(self, nodes: np.ndarray) -> np.ndarray:
        """Return the shortest way through the rest shape from every node to given nodes (A,), as (N, A) float32 [m]."""
        if self.geodesics is not None:
            return self.geodesics[:, nodes]
        i, j = self.edges.T
        graph = coo_matrix((self.rest_lengths, (i, j)), shape=(self.num_nodes, self.num_nodes))
        return dijkstra(graph, directed=False, indices=nodes).T.astype(np.float32)
