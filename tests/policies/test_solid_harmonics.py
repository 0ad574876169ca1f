"""Solid harmonics and radial functions: what makes a kernel steerable (eq. 29, 30)."""

import numpy as np
import pytest
import torch
from hypothesis import given
from random_graphs import QUATERNIONS, rotation_from_quaternion

from maniskill_grpd.policies.layers import EdgeGeometry, RadialBasis, solid_harmonics

DEGREES = {0: slice(0, 1), 1: slice(1, 4), 2: slice(4, 9)}


def harmonics_of(vectors):
    """(..., 3) -> (..., 9)."""
    return torch.stack(solid_harmonics(*vectors.unbind(-1), 2), dim=-1)


def sphere_quadrature():
    """Points and weights that integrate polynomials up to degree 9 exactly; weights sum to 1."""
    z, weight = np.polynomial.legendre.leggauss(5)
    angle = 2 * np.pi * np.arange(10) / 10
    z, angle = (x.ravel() for x in np.meshgrid(z, angle, indexing="ij"))
    ring = np.sqrt(1 - z**2)
    points = np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=-1)
    return torch.tensor(points), torch.tensor(np.repeat(weight, 10) / 20)


def test_harmonics_are_orthonormal_on_the_sphere():
    """The mean of Y_i Y_j over the unit sphere is the identity."""
    points, weights = sphere_quadrature()
    values = harmonics_of(points)
    gram = torch.einsum("p,pi,pj->ij", weights, values, values)
    torch.testing.assert_close(gram, torch.eye(9, dtype=torch.float64))


def test_square_sum_of_a_degree_is_constant_on_the_sphere():
    """Unsoeld: sum_m Y_lm^2 = 2 l + 1."""
    points, _ = sphere_quadrature()
    values = harmonics_of(points).square()
    for degree, entries in DEGREES.items():
        torch.testing.assert_close(values[:, entries].sum(-1), torch.full((50,), 2.0 * degree + 1, dtype=torch.float64))


@given(QUATERNIONS)
def test_rotation_mixes_a_degree_orthogonally(quaternion):
    """Y_l(R p) = D_l Y_l(p) with orthogonal D_l, and D_1 = R."""
    rotation = rotation_from_quaternion(quaternion)
    points = torch.randn(40, 3, dtype=torch.float64)
    before, after = harmonics_of(points), harmonics_of(points @ rotation.T)
    for degree, entries in DEGREES.items():
        d = torch.linalg.lstsq(before[:, entries], after[:, entries]).solution.T
        torch.testing.assert_close(before[:, entries] @ d.T, after[:, entries])
        torch.testing.assert_close(d @ d.T, torch.eye(2 * degree + 1, dtype=torch.float64))
        if degree == 1:
            torch.testing.assert_close(d, rotation)


def test_harmonics_are_homogeneous():
    """Scaling p scales degree l with the l-th power, the factor |p|^l of eq. 19."""
    points = torch.randn(10, 3, dtype=torch.float64)
    powers = torch.tensor([0] + [1] * 3 + [2] * 5)
    torch.testing.assert_close(harmonics_of(3.0 * points), harmonics_of(points) * 3.0**powers)


def test_fewer_degrees_are_a_prefix():
    points = torch.randn(10, 3)
    full = solid_harmonics(*points.unbind(-1), 2)
    for degree, count in ((0, 1), (1, 4), (2, 9)):
        part = solid_harmonics(*points.unbind(-1), degree)
        assert len(part) == count
        assert all(torch.equal(a, b) for a, b in zip(part, full[:count], strict=True))


def test_degree_three_is_refused():
    with pytest.raises(ValueError, match="got 3"):
        solid_harmonics(*torch.zeros(3, 1), 3)


def test_radial_functions_are_bounded_and_reach_everywhere():
    """The first function is one at every distance, the others bumps that no distance escapes."""
    distance = torch.linspace(0.0, 100.0, 1000, dtype=torch.float64)
    values = torch.stack(RadialBasis(6, 0.8)(distance))
    assert values.shape == (6, 1000)
    assert (values[0] == 1.0).all()
    assert values.min() >= 0.0
    assert values.max() <= 1.0
    assert (values[1:].max(dim=0).values > 0.5).all()
    with pytest.raises(ValueError, match="got 0"):
        RadialBasis(0, 1.0)


def test_kernel_is_smooth_where_sender_meets_receiver():
    """Direction is undefined at distance zero; kernel factors and their gradients are finite."""
    geometry = EdgeGeometry(4, 2, 0.8, 0.04)
    sender = torch.zeros(3, 1, 2, dtype=torch.float64, requires_grad=True)
    receiver = torch.zeros(3, 1, 1, dtype=torch.float64)
    edges = geometry.complete(sender, torch.ones(1, 2, dtype=torch.bool), receiver)
    assert (edges.weights[:, 1:] == 0).all()
    (gradient,) = torch.autograd.grad(edges.weights.sum(), sender)
    assert torch.isfinite(gradient).all()
