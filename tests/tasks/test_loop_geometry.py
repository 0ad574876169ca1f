"""Closed polygons in space."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.tasks.geometry.loop_geometry import loop_area, loop_centre, winding_about_axis


def circle(num=12, radius=2.0):
    angle = torch.arange(num, dtype=torch.float64) * (2 * math.pi / num)
    return torch.stack([radius * angle.cos(), radius * angle.sin(), 0 * angle], dim=-1)[None]


def test_area_vector_of_a_square_is_its_area_along_the_normal_wherever_it_is():
    square = torch.tensor([[[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [3.0, 2.0, 0.0], [0.0, 2.0, 0.0]]], dtype=torch.float64)
    turn = torch.as_tensor(Rotation.random(random_state=0).as_matrix())
    moved = square @ turn.T + torch.tensor([5.0, -3.0, 7.0])
    torch.testing.assert_close(loop_area(moved), (turn @ torch.tensor([0.0, 0.0, 6.0], dtype=torch.float64))[None])
    torch.testing.assert_close(loop_area(moved.flip(1)), -loop_area(moved))


def test_centre_is_that_of_the_curve_and_not_of_its_points():
    """Many points on one side of a square do not pull the centre there."""
    corners = torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    crowded = torch.cat([torch.stack([torch.linspace(0, 0.9, 10), torch.zeros(10), torch.zeros(10)], dim=-1), corners[1:]])
    torch.testing.assert_close(loop_centre(crowded[None]), torch.tensor([[0.5, 0.5, 0.0]]))


@pytest.mark.parametrize("flip", [False, True])
def test_lines_inside_wind_once_and_lines_outside_not_at_all(flip):
    loop = circle().flip(1) if flip else circle()
    origins = torch.tensor([[0.0, 0.0, 5.0], [1.9, 0.0, -1.0], [2.1, 0.0, 0.0], [9.0, 0.0, 0.0]], dtype=torch.float64)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64).expand(4, 3)
    winding = winding_about_axis(loop.expand(4, -1, -1), origins, up)
    sign = -1.0 if flip else 1.0
    torch.testing.assert_close(winding, sign * torch.tensor([1.0, 1.0, 0.0, 0.0], dtype=torch.float64), atol=1e-9, rtol=0)
    torch.testing.assert_close(winding_about_axis(loop.expand(4, -1, -1), origins, -up), -winding, atol=1e-9, rtol=0)


def test_a_line_in_the_plane_of_the_loop_does_not_pass_through_it():
    along = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    origin = torch.tensor([[0.0, 0.1, 0.0]], dtype=torch.float64)
    tilted = circle() + torch.tensor([0.0, 0.0, 1e-3])
    assert winding_about_axis(tilted, origin, along).abs().item() < 1e-9


def test_repeating_a_point_changes_nothing():
    loop = circle() + 0.1 * torch.randn(1, 12, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    padded = torch.cat([loop, loop[:, -1:].expand(-1, 5, -1)], dim=1)
    up = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    for measure in (loop_centre, loop_area, lambda points: winding_about_axis(points, 0.3 * up, up)):
        torch.testing.assert_close(measure(padded), measure(loop))
