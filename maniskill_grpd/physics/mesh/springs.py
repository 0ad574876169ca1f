"""Springs along and across the triangles of a surface, as stiff as a sheet."""

from __future__ import annotations

import numpy as np

from maniskill_grpd.physics.mesh.fit import fit_stiffness
from maniskill_grpd.physics.mesh.surface import Surface

# Two triangles form nearly a rectangle, and get a spring across, if its diagonals differ by less than this factor.
RECTANGLE_RATIO = 1.2
# A spring across two triangles that are folded resists bending: there is none where it would be shorter by more than this share.
MAX_SHORTENING = 1e-3


def fit_springs(surface: Surface, stretch_stiffness: float, shear_stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return springs (E, 2) along all edges, and across pairs of triangles that form a rectangle, with their stiffnesses [N/m].

    A spring of stiffness k strained along u stores 1/2 k (d . u)^4 / |d|^2 with d its rest vector. The sheet prescribes
    C_11 (cos^4 + sin^4) + 6 G cos^2 sin^2, where C_12 = G as in every network of springs, and E = C_11 - G^2 / C_11. The angles
    are those in the frames of the triangles; with G = 3/8 E they do not matter.

    Args:
        surface: The sheet.
        stretch_stiffness: E [N/m].
        shear_stiffness: G [N/m].
    """
    c11 = 0.5 * (stretch_stiffness + np.sqrt(stretch_stiffness**2 + 4.0 * shear_stiffness**2))
    target = np.array([0.75 * (c11 + shear_stiffness), 0.0, 0.0, 0.25 * (c11 - 3.0 * shear_stiffness), 0.0])
    members = surface.faces_of_edges
    members = np.where(members < 0, members[:, ::-1], members)  # a boundary spring belongs to its one triangle alone
    along = (surface.points[surface.edges[:, 1]] - surface.points[surface.edges[:, 0]])[:, None]
    vectors = np.einsum("esd,escd->esc", np.broadcast_to(along, (*members.shape, 3)), surface.frames[members])

    corners = np.stack([surface.unfold(surface.pair_nodes, surface.pair_faces[:, side]) for side in range(2)], axis=1)
    across = corners[:, :, 3] - corners[:, :, 2]
    ratio = np.linalg.norm(across[:, 0], axis=1) / np.linalg.norm(corners[:, 0, 1] - corners[:, 0, 0], axis=1)
    is_rectangle = (ratio < RECTANGLE_RATIO) & (ratio > 1.0 / RECTANGLE_RATIO)
    distance = np.linalg.norm(np.diff(surface.points[surface.pair_nodes[:, 2:]], axis=1)[:, 0], axis=1)
    is_rectangle &= distance > (1.0 - MAX_SHORTENING) * np.linalg.norm(across[:, 0], axis=1)
    edges = np.concatenate([surface.edges, np.sort(surface.pair_nodes[is_rectangle, 2:], axis=1)])
    members = np.concatenate([members, surface.pair_faces[is_rectangle]])
    vectors = np.concatenate([vectors, across[is_rectangle]])
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    form = np.concatenate([vectors**2, vectors[..., :1] * vectors[..., 1:]], axis=-1) / length
    order = np.lexsort(edges.T[::-1])
    return edges[order], fit_stiffness(form, members, surface.areas, target)[order]
