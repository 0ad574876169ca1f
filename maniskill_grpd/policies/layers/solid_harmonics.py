"""Real solid harmonics up to degree 2."""

from __future__ import annotations

import math

import torch

MAX_DEGREE = 2


def solid_harmonics(x: torch.Tensor, y: torch.Tensor, z: torch.Tensor, max_degree: int) -> list[torch.Tensor]:
    r"""Real solid harmonics |u|^l Y_lm(u / |u|) of u = (x, y, z), as in eq. 19 and 30.

    Being polynomials they are smooth at u = 0, where the direction u / |u| is not defined.
    Normalised such that sum_m Y_lm(u)^2 = 2 l + 1 on the unit sphere; order within degree 1: x, y,
    z; within degree 2: xy, yz, 3z^2 - r^2, xz, x^2 - y^2.

    Symmetry: for a rotation R the values of one degree l turn into D_l(R) times themselves, with
    D_l orthogonal; D_0 = 1, D_1 = R.

    Args:
        x: First component, any shape.
        y: Second component, same shape.
        z: Third component, same shape.
        max_degree: 0, 1 or 2.

    Returns:
        (max_degree + 1)^2 tensors of the shape of x.

    Raises:
        ValueError: If max_degree is not 0, 1 or 2.
    """
    if max_degree not in range(MAX_DEGREE + 1):
        raise ValueError(f"max_degree must be 0, 1 or 2, got {max_degree}")
    harmonics = [torch.ones_like(x)]
    if max_degree >= 1:
        harmonics += [math.sqrt(3.0) * component for component in (x, y, z)]
    if max_degree >= 2:
        root = math.sqrt(15.0)
        xx, yy = x * x, y * y
        harmonics += [
            root * x * y,
            root * y * z,
            0.5 * math.sqrt(5.0) * (2.0 * z * z - xx - yy),
            root * x * z,
            0.5 * root * (xx - yy),
        ]
    return harmonics
