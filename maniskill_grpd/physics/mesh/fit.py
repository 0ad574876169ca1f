"""Stiffnesses of springs and hinges that make a mesh behave like a sheet.

Springs and hinges store 1/2 k a(u)^2 when the sheet is strained, or bent, along a direction u in its plane. Summed over a
triangle and divided by its area that is a trigonometric polynomial of degree four in the angle of u, and a sheet prescribes its
five coefficients. The stiffnesses k >= 0 are the least-squares solution over all triangles; a square grid and a triangular
lattice meet an isotropic sheet exactly, at every resolution.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, identity
from scipy.sparse.linalg import spsolve

# Smallest stiffness relative to the median that is allowed, so that no edge of the mesh is left loose.
MIN_RELATIVE_STIFFNESS = 0.02


def quartic_coefficients(form: np.ndarray) -> np.ndarray:
    """Expand a(u)^2 of quadratic forms a(u) = u^T S u into (1, cos 2p, sin 2p, cos 4p, sin 4p) of the angle p of u.

    Args:
        form: Symmetric matrices S as rows (S_xx, S_yy, S_xy), (C, 3).

    Returns:
        (C, 5).
    """
    mean, cos2, sin2 = 0.5 * (form[:, 0] + form[:, 1]), 0.5 * (form[:, 0] - form[:, 1]), form[:, 2]
    return np.column_stack(
        [mean**2 + 0.5 * (cos2**2 + sin2**2), 2 * mean * cos2, 2 * mean * sin2, 0.5 * (cos2**2 - sin2**2), cos2 * sin2]
    )


def fit_stiffness(form: np.ndarray, members: np.ndarray, areas: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Fit non-negative stiffnesses to a sheet.

    Args:
        form: Quadratic form of each spring or hinge as (S_xx, S_yy, S_xy) in the frame of each of its triangles, (C, S, 3).
        members: Triangles that share the energy of each equally, (C, S) int; -1 for one that is missing beyond a boundary, whose
            share is then lost.
        areas: Areas of the triangles, (F,) [m^2].
        target: Coefficients of the sheet's stiffness per area (see `quartic_coefficients`), (5,).

    Returns:
        Stiffness of each, (C,) in the unit of target * area / form^2.
    """
    expanded = np.stack([quartic_coefficients(form[:, side]) for side in range(members.shape[1])], axis=1)
    scale = target[0] * areas.mean() / expanded[:, 0, 0]  # unknowns of order one
    num_constraints, num_shares = members.shape
    rows, columns, values = [], [], []
    for side in range(num_shares):
        index = np.flatnonzero(members[:, side] >= 0)
        face = members[index, side]
        weight = scale[index] / (num_shares * np.sqrt(areas[face] * areas.mean()) * target[0])
        for term in range(5):
            rows.append(5 * face + term)
            columns.append(index)
            values.append(weight * expanded[index, side, term])
    shape = (5 * len(areas), num_constraints)
    matrix = coo_matrix((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape).tocsr()
    wanted = (np.sqrt(areas / areas.mean())[:, None] * target / target[0]).ravel()
    normal = (matrix.T @ matrix + 1e-9 * identity(num_constraints)).tocsc()
    return scale * _bounded_least_squares(normal, matrix.T @ wanted)


def _bounded_least_squares(normal: csc_matrix, moment: np.ndarray) -> np.ndarray:
    """Minimise 1/2 k^T normal k - moment^T k with k >= bound: what falls below is held there, until nothing does."""
    stiffness = spsolve(normal, moment)
    bound = MIN_RELATIVE_STIFFNESS * np.median(np.abs(stiffness))
    free = np.ones(len(moment), dtype=bool)
    while (free & (stiffness < bound)).any():
        free &= stiffness >= bound
        stiffness = np.where(free, stiffness, bound)
        coupled = moment[free] - normal[free][:, ~free] @ stiffness[~free]
        stiffness[free] = spsolve(normal[free][:, free], coupled)
    return stiffness
