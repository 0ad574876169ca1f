"""How often a cloth passes through itself: edges that cross triangles of the same surface."""

from __future__ import annotations

import torch

from maniskill_grpd.physics.model import Model

# Barycentric coordinates and fractions closer to 0 or 1 than this are touching, not crossing.
MARGIN = 1e-6
# Determinants below this [m^3] belong to edges in the plane of a triangle, which cross nothing.
SMALLEST_DETERMINANT = 1e-14
# Pairs of an edge and a triangle that are looked at together.
CHUNK = 2_000_000


def count_crossings(model: Model, positions: torch.Tensor) -> torch.Tensor:
    """Return how many pairs of an edge and a triangle, which share no node, cross in each world (Moeller and Trumbore 1997).

    Args:
        model: The cloth; a rope has no triangles, and so no crossings.
        positions: Its nodes, and padding behind them, (B, N, 3) [m].

    Returns:
        Counts, (B,) int64.
    """
    faces = torch.as_tensor(model.faces, dtype=torch.int64, device=positions.device)
    edges = torch.as_tensor(model.surface_edges, dtype=torch.int64, device=positions.device)
    counts = torch.zeros(len(positions), dtype=torch.int64, device=positions.device)
    strangers = ~(faces[None, :, :, None] == edges[:, None, None, :]).any(dim=(2, 3))
    for worlds in torch.arange(len(positions), device=positions.device).split(max(1, CHUNK // max(strangers.numel(), 1))):
        points = positions[worlds].double()
        triangles, ends = points[:, faces], points[:, edges]  # (b, F, 3, 3), (b, E, 2, 3)
        apart = ends.amin(2)[:, :, None] > triangles.amax(2)[:, None]
        apart |= ends.amax(2)[:, :, None] < triangles.amin(2)[:, None]
        world, edge, face = torch.nonzero(~apart.any(-1) & strangers, as_tuple=True)
        crosses = _crosses(ends[world, edge], triangles[world, face])
        counts[worlds] = torch.bincount(world[crosses], minlength=len(worlds))
    return counts


def _crosses(ends: torch.Tensor, triangles: torch.Tensor) -> torch.Tensor:
    """Return whether edges (P, 2, 3) cross triangles (P, 3, 3), (P,) bool."""
    origin, first, second = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    along, offset = ends[:, 1] - ends[:, 0], ends[:, 0] - origin
    normal = torch.linalg.cross(along, second)
    determinant = (normal * first).sum(-1)
    is_regular = determinant.abs() > SMALLEST_DETERMINANT
    inverse = torch.where(is_regular, 1.0 / torch.where(is_regular, determinant, 1.0), 0.0)
    u = (offset * normal).sum(-1) * inverse
    other = torch.linalg.cross(offset, first)
    v = (along * other).sum(-1) * inverse
    t = (second * other).sum(-1) * inverse
    is_inside = (u > MARGIN) & (v > MARGIN) & (u + v < 1.0 - MARGIN)
    return is_regular & is_inside & (t > MARGIN) & (t < 1.0 - MARGIN)
