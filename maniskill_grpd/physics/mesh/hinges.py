"""Bending constraints between the triangles of a surface, as stiff as a plate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maniskill_grpd.physics.mesh.fit import fit_stiffness, quartic_coefficients
from maniskill_grpd.physics.mesh.surface import Surface


@dataclass(frozen=True)
class Bending:
    """Hinges between two triangles and triples of nodes in a row, with their stiffnesses."""

    hinges: np.ndarray
    """Two nodes of an edge and the two opposite it, (H, 4) int64."""
    weights: np.ndarray
    """Weights w of C = sum_k w_k x_k with the hinge unfolded, (H, 4)."""
    hinge_stiffness: np.ndarray
    """(H,) [N/m]."""
    sines: np.ndarray
    """sin(theta / 2) of the angle theta by which each hinge is folded at rest, (H,)."""
    triples: np.ndarray
    """Nodes in a row, each a constraint C = x_p - 2 x_m + x_n, (T, 3) int64."""
    triple_stiffness: np.ndarray
    """(T,) [N/m]."""


def fit_bending(surface: Surface, bend_stiffness: float) -> Bending:
    """Fit constraints that bend like a plate of the given rigidity [N m].

    Hinges have the cotangent weights of isometric bending (Bergou et al. 2006): C = sum_k weight_k x_k is linear in the positions
    and vanishes for all in-plane strains. Rolled up along u with curvature kappa it measures kappa times
    sum_k weight_k (u . x_k)^2 / 2. Where two right angles meet at a side, as in a square grid, a hinge sees but three nodes of
    a row; triples x_p - 2 x_m + x_n of all rows and columns take their place, so that no node is left free to bend. Rows are
    found in flat sheets only.

    Free boundaries carry no moment: constraints that reach beyond them take part in the fit and are dropped.
    """
    if bend_stiffness == 0.0:
        none = np.zeros(0)
        return Bending(np.zeros((0, 4), np.int64), np.zeros((0, 4)), none, none, np.zeros((0, 3), np.int64), none)
    corners, hinge_faces = _hinges_with_mirrored(surface)
    weights = _hinge_weights(corners[:, 0])
    is_row = np.abs(weights[:, :2]).min(axis=1) < 1e-5 * np.abs(weights).max(axis=1)
    is_flat = not surface.points[:, 2].any()
    triples, row_vectors, row_members = _rows(surface) if is_flat and is_row.any() else _no_rows()
    is_row &= len(triples) > 0  # right angles of a lattice that is turned out of the axes belong to no row
    num_inner = len(surface.pair_faces)
    kept = np.flatnonzero(~is_row)
    form = _curvature_form(corners, weights)[kept]
    members = np.repeat(hinge_faces[kept], 2, axis=1)

    row_form = np.column_stack([row_vectors**2, row_vectors[:, 0] * row_vectors[:, 1]])
    target = quartic_coefficients(np.array([[1.0, 1.0, 0.0]]))[0] * bend_stiffness
    forms = np.concatenate([np.repeat(form, 2, axis=1), np.repeat(row_form[:, None], 4, axis=1)])
    stiffness = fit_stiffness(forms, np.concatenate([members, row_members]), surface.areas, target)
    is_hinge = kept < num_inner
    is_triple = triples[:, 2] >= 0
    inner = kept[is_hinge]
    return Bending(
        hinges=surface.pair_nodes[inner],
        weights=weights[inner],
        hinge_stiffness=stiffness[: len(kept)][is_hinge],
        sines=surface.fold_sines()[inner],
        triples=triples[is_triple],
        triple_stiffness=stiffness[len(kept) :][is_triple],
    )


def _curvature_form(corners: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return what hinges (H, S, 4, 2) with weights (H, 4) measure of a unit curvature, as (S_xx, S_yy, S_xy), (H, S, 3) [m^2]."""
    centered = corners - corners.mean(axis=2, keepdims=True)
    products = np.stack([centered[..., 0] ** 2, centered[..., 1] ** 2, centered[..., 0] * centered[..., 1]], axis=-1)
    return 0.5 * (weights[:, None, :, None] * products).sum(axis=2)


def _hinges_with_mirrored(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Return all hinges, then those of boundary edges with a mirrored triangle.

    Returns:
        corners: In the frames of their two triangles, into whose planes they are unfolded, (H, 2, 4, 2) [m].
        faces: The two triangles, -1 for a mirrored one, (H, 2).
    """
    boundary = np.flatnonzero(surface.faces_of_edges[:, 1] < 0)
    rim, rim_face = surface.edges[boundary], surface.faces_of_edges[boundary, 0]
    apex = surface.faces[rim_face].sum(axis=1) - rim.sum(axis=1)
    mirrored = surface.unfold(np.column_stack([rim, apex, apex]), rim_face)
    along = mirrored[:, 1] - mirrored[:, 0]
    normal = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1, keepdims=True)
    height = ((mirrored[:, 2] - mirrored[:, 0]) * normal).sum(axis=1, keepdims=True)
    mirrored[:, 3] = mirrored[:, 2] - 2.0 * height * normal
    inner = np.stack([surface.unfold(surface.pair_nodes, surface.pair_faces[:, side]) for side in range(2)], axis=1)
    faces = np.concatenate([surface.pair_faces, np.column_stack([rim_face, np.full(len(rim), -1)])])
    return np.concatenate([inner, np.stack([mirrored, mirrored], axis=1)]), faces


def _rows(surface: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return triples of nodes in the rows and columns of a square grid in the plane.

    Where a row ends at a node its last edge alone counts, with -1 as the third node.

    Returns:
        triples: (previous, middle, next), (T, 3).
        vectors: From the middle to the next node, or to the previous one, (T, 2) [m].
        members: Triangles at the two edges, those at the boundary twice, -1 beyond the end, (T, 4).
    """
    points, edges = surface.points[:, :2], surface.edges
    vector = points[edges[:, 1]] - points[edges[:, 0]]
    straight = np.flatnonzero(np.abs(vector).min(axis=1) < 1e-6 * np.abs(vector).max(axis=1))
    around: dict[tuple[int, int, int], tuple[int, int]] = {}  # (node, axis, sign) -> (neighbor, edge)
    for edge in straight:
        axis = int(np.abs(vector[edge]).argmax())
        sign = int(np.sign(vector[edge, axis]))
        first, second = (int(node) for node in edges[edge])
        around[first, axis, sign], around[second, axis, -sign] = (second, edge), (first, edge)
    triples, vectors, members = [], [], []
    for (node, axis, sign), (neighbor, edge) in sorted(around.items()):
        step = points[neighbor] - points[node]
        other, other_edge = around.get((node, axis, -sign), (-1, -1))
        is_even = other >= 0 and np.linalg.norm(points[other] - points[node] + step) < 1e-3 * np.linalg.norm(step)
        faces = surface.faces_of_edges[edge]
        faces = np.where(faces < 0, faces[::-1], faces)
        if is_even and sign > 0:
            other_faces = surface.faces_of_edges[other_edge]
            triples.append([other, node, neighbor])
            members.append([*faces, *np.where(other_faces < 0, other_faces[::-1], other_faces)])
        elif not is_even:
            triples.append([neighbor, node, -1])
            members.append([*faces, -1, -1])
        else:
            continue
        vectors.append(step)
    return (np.array(triples), np.array(vectors), np.array(members)) if triples else _no_rows()


def _no_rows() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.zeros((0, 3), np.int64), np.zeros((0, 2)), np.zeros((0, 4), np.int64)


def _hinge_weights(corners: np.ndarray) -> np.ndarray:
    """Return the weights of hinges with planar corners (H, 4, 2): edge 0-1, opposite nodes 2 and 3."""

    def cotangent(at: int, a: int, b: int) -> np.ndarray:
        p, q = corners[:, a] - corners[:, at], corners[:, b] - corners[:, at]
        return (p * q).sum(axis=1) / np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])

    c01, c02 = cotangent(0, 1, 2), cotangent(0, 1, 3)
    c03, c04 = cotangent(1, 0, 2), cotangent(1, 0, 3)
    return np.column_stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04])
