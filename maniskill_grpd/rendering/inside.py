"""Cameras that stand inside something."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch

from maniskill_grpd.rendering.labels import Label
from maniskill_grpd.rendering.triangle_scene import TriangleScene


def is_inside(scene: TriangleScene, worlds: torch.Tensor, points: torch.Tensor, labels: Sequence[Label]) -> torch.Tensor:
    """Tell which points are inside closed surfaces: those that triangles surround, by the solid angles under which they appear.

    Args:
        scene: The triangles.
        worlds: Some of the worlds, (b,) int64.
        points: One in each of them, (b, 3) [m].
        labels: What triangles count; together they are closed.

    Returns:
        (b,) bool.
    """
    variants = scene.variants[worlds].long()
    corners = scene.vertices[worlds[:, None, None], scene.triangles[variants].long()].double() - points[:, None, None].double()
    a, b, c = corners.unbind(2)
    la, lb, lc = (torch.linalg.vector_norm(side, dim=-1) for side in (a, b, c))
    # Van Oosterom and Strackee (1983): tan(angle / 2) of a triangle seen from the origin.
    volume = (a * torch.linalg.cross(b, c)).sum(-1)
    rest = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    counts = torch.isin(scene.labels[variants], torch.tensor([int(label) for label in labels], device=points.device))
    angles = torch.where(counts, 2.0 * torch.atan2(volume, rest), 0.0).nan_to_num(0.0)  # what is not there is nowhere
    return angles.sum(dim=1).abs() > 2.0 * math.pi  # a closed surface covers 4 pi from inside, 0 from outside
