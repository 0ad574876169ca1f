"""Winding numbers against closed forms, and taut curves against the shortest ones."""

import math

import pytest
import torch

from maniskill_grpd.tasks.geometry.winding import winding_number


def arc(turns, num_nodes=40, centre=(0.0, 0.0)):
    """Return unevenly spaced nodes (1, N, 2) on an arc of radius 1."""
    angle = 2 * math.pi * turns * torch.linspace(0.0, 1.0, num_nodes, dtype=torch.float64) ** 1.5
    return torch.stack([angle.cos() + centre[0], angle.sin() + centre[1]], dim=-1)[None]


def wind(points, mask=None):
    mask = torch.ones(points.shape[:2], dtype=torch.bool) if mask is None else mask
    return winding_number(points, mask).item()


@pytest.mark.parametrize("turns", [0.25, 0.95, 1.0, -1.0, 2.0, -2.5])
def test_arcs_wind_by_their_turns(turns):
    assert wind(arc(turns)) == pytest.approx(turns, abs=1e-12)


def test_closed_curves_wind_by_whole_turns_wherever_the_origin_is():
    assert wind(arc(1.0, centre=(0.6, -0.5))) == pytest.approx(1.0, abs=1e-12)
    assert wind(arc(1.0, centre=(0.8, -0.7))) == pytest.approx(0.0, abs=1e-12)
    there_and_back = torch.cat([arc(0.8), arc(0.8).flip(1)], dim=1)
    assert wind(there_and_back) == pytest.approx(0.0, abs=1e-12)


def test_winding_needs_no_fine_curve_and_ignores_padding():
    triangle = torch.tensor([[[1.0, 0], [-1, 1], [-1, -1], [1, 0], [0, 0], [5, 5]]], dtype=torch.float64)
    mask = torch.tensor([[True] * 4 + [False] * 2])
    assert wind(triangle, mask) == pytest.approx(1.0, abs=1e-12)


def test_winding_does_not_depend_on_the_frame_and_changes_sign_in_a_mirror():
    curve = torch.randn(1, 30, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    turn = torch.tensor([[0.6, -0.8], [0.8, 0.6]], dtype=torch.float64)
    assert wind(curve @ turn) == pytest.approx(wind(curve), abs=1e-12)
    assert wind(curve * torch.tensor([1.0, -1.0])) == pytest.approx(-wind(curve), abs=1e-12)
    assert wind(curve.flip(1)) == pytest.approx(-wind(curve), abs=1e-12)
