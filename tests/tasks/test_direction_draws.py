"""Random directions and orientations."""

import math

import numpy as np
import pytest
import torch
from mani_skill.utils.geometry.rotation_conversions import quaternion_to_matrix
from scipy import stats

from maniskill_grpd.tasks.geometry.direction_draws import directions_in_cap, orientations_in_cap, tilts_of_z

NUM = 20_000


def draws(num):
    return torch.rand(NUM, num, generator=torch.Generator().manual_seed(0)) * 2 - 1


@pytest.mark.parametrize("half_angle", [math.pi, math.pi / 4])
def test_directions_are_uniform_on_the_cap(half_angle):
    """Equal areas: the height z and the angle about z are uniform and independent."""
    x, y, z = directions_in_cap(draws(2), half_angle).double().numpy().T
    np.testing.assert_allclose(x**2 + y**2 + z**2, 1.0, atol=1e-5)
    lowest = math.cos(half_angle)
    assert stats.kstest(z, "uniform", args=(lowest, 1 - lowest)).pvalue > 1e-3
    assert stats.kstest(np.arctan2(y, x), "uniform", args=(-math.pi, 2 * math.pi)).pvalue > 1e-3
    assert abs(np.corrcoef(z, np.arctan2(y, x))[0, 1]) < 0.03  # 4 sigma


def test_orientations_of_the_full_range_are_uniform_over_all_rotations():
    """The angle of a uniform rotation has the density (1 - cos) / pi, so its distribution is (t - sin t) / pi."""
    rotations = quaternion_to_matrix(orientations_in_cap(draws(3), math.pi)).double()
    trace = rotations.diagonal(dim1=1, dim2=2).sum(1).numpy()
    angle = np.arccos(np.clip((trace - 1) / 2, -1, 1))
    assert stats.kstest(angle, lambda t: (t - np.sin(t)) / np.pi).pvalue > 1e-3


def test_smaller_ranges_bound_tilt_and_turn():
    rotations = quaternion_to_matrix(orientations_in_cap(draws(3), math.pi / 4))
    tilt = torch.acos(rotations[:, 2, 2].clamp(-1, 1))
    assert tilt.max() <= math.pi / 4 + 1e-3
    assert tilt.max() > 0.99 * math.pi / 4
    untilted = quaternion_to_matrix(tilts_of_z(rotations[..., 2])).mT @ rotations
    turn = torch.atan2(untilted[:, 1, 0], untilted[:, 0, 0])
    assert turn.abs().max() <= math.pi / 4 + 1e-3
    assert turn.abs().max() > 0.99 * math.pi / 4


def test_tilts_take_z_to_any_direction_even_to_the_opposite_one():
    directions = torch.cat([directions_in_cap(draws(2)[:100], math.pi), torch.eye(3), -torch.eye(3)])
    rotations = quaternion_to_matrix(tilts_of_z(directions))
    torch.testing.assert_close(rotations[..., 2], directions, atol=1e-5, rtol=0)
    torch.testing.assert_close(torch.linalg.det(rotations), torch.ones(106), atol=1e-5, rtol=0)
