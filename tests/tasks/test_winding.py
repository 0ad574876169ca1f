"""Winding numbers against closed forms, and taut curves against the shortest ones."""

import math

import pytest
import torch
from scipy.spatial.transform import Rotation

from maniskill_grpd.tasks.post_leash import limit_around_post
from maniskill_grpd.tasks.winding import angles_between, arms_from_axis, taut_curve, winding_number

UP = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
ORIGIN = torch.zeros(1, 3, dtype=torch.float64)


def arc(turns, num_nodes=40, centre=(0.0, 0.0), radius=1.0):
    """Return nodes (1, N, 3) on an arc, unevenly spaced and at changing heights."""
    share = torch.linspace(0.0, 1.0, num_nodes, dtype=torch.float64) ** 1.5
    angle = 2 * math.pi * turns * share
    x, y = radius * angle.cos() + centre[0], radius * angle.sin() + centre[1]
    return torch.stack([x, y, 0.3 * (7.0 * share).sin()], dim=-1)[None]


def wind(points, mask=None, origin=ORIGIN, axis=UP):
    mask = torch.ones(points.shape[:2], dtype=torch.bool) if mask is None else mask
    return winding_number(arms_from_axis(points, origin, axis), mask, axis).item()


@pytest.mark.parametrize("turns", [0.25, 0.95, 1.0, -1.0, 2.0, -2.5])
def test_arcs_wind_by_their_turns(turns):
    assert wind(arc(turns)) == pytest.approx(turns, abs=1e-12)


def test_closed_curves_wind_by_whole_turns_wherever_the_axis_is():
    assert wind(arc(1.0, centre=(0.6, -0.5))) == pytest.approx(1.0, abs=1e-12)
    assert wind(arc(1.0, centre=(0.8, -0.7))) == pytest.approx(0.0, abs=1e-12)
    there_and_back = torch.cat([arc(0.8), arc(0.8).flip(1)], dim=1)
    assert wind(there_and_back) == pytest.approx(0.0, abs=1e-12)


def test_winding_needs_no_fine_curve_and_ignores_padding():
    triangle = torch.tensor([[[1.0, 0, 0], [-1, 1, 0], [-1, -1, 0], [1, 0, 0], [0, 0, 0], [5, 5, 5]]], dtype=torch.float64)
    mask = torch.tensor([[True] * 4 + [False] * 2])
    assert wind(triangle, mask) == pytest.approx(1.0, abs=1e-12)


def test_winding_moves_with_the_axis():
    rotation = torch.as_tensor(Rotation.random(random_state=3).as_matrix())
    translation = torch.tensor([[0.3, -2.0, 1.0]], dtype=torch.float64)
    moved = arc(-1.3) @ rotation.T + translation
    assert wind(moved, origin=translation, axis=UP @ rotation.T) == pytest.approx(-1.3, abs=1e-12)
    assert wind(moved, origin=translation, axis=-UP @ rotation.T) == pytest.approx(1.3, abs=1e-12)


def polar(radius, angle):
    return torch.tensor([radius * math.cos(angle), radius * math.sin(angle), 0.0], dtype=torch.float64)


def taut(first, second, turned, radius=0.1):
    ends = torch.stack([first, second])[None]
    turned, radius = (torch.tensor([value], dtype=torch.float64) for value in (turned, radius))
    length, directions = taut_curve(ends, turned, radius, UP)
    return length.item(), directions[0]


@pytest.mark.parametrize(
    ("first", "second", "turned", "expected"),
    [
        (polar(0.1, 0.0), polar(0.1, 3.0), 3.0, 0.3),  # an arc alone
        (polar(0.1, 0.0), polar(0.1, -1.0), 2 * math.pi - 1.0, 0.1 * (2 * math.pi - 1.0)),
        (polar(0.2, 0.0), polar(0.2, math.pi), -math.pi, 2 * 0.03**0.5 + 0.1 * math.pi / 3),  # two tangents, 60 degrees each
        (polar(0.2, 0.0), polar(0.2, 0.5), 0.5, 0.0),  # a chord that passes the cylinder
    ],
)
def test_taut_curves_have_the_length_of_tangents_and_arc(first, second, turned, expected):
    assert taut(first, second, turned)[0] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("turned", [4.0, -4.0])
def test_taut_curves_grow_along_the_directions_of_their_ends(turned):
    first, second = polar(0.3, 0.0), polar(0.25, turned)
    length, directions = taut(first, second, turned)
    torch.testing.assert_close(directions.norm(dim=-1), torch.ones(2, dtype=torch.float64))
    for end in range(2):
        for shift in 1e-6 * torch.eye(3, dtype=torch.float64)[:2]:
            ends = [first, second]
            ends[end] = ends[end] + shift
            moved = angles_between(torch.stack([first, second])[None], torch.stack(ends)[None], UP)[0]
            change = taut(*ends, turned + (moved[1] - moved[0]).item())[0] - length
            assert change == pytest.approx((directions[end] @ shift).item(), abs=1e-10)


def draw_ends(num=500):
    generator = torch.Generator().manual_seed(0)
    radii = 0.08 + torch.rand(num, 2, generator=generator)
    turned = 12.0 * torch.rand(num, generator=generator) - 6.0
    start = 6.0 * torch.rand(num, generator=generator)
    angles = torch.stack([start, start + turned], dim=1)
    heights = 0.3 * torch.rand(num, 2, generator=generator)
    return torch.stack([radii * angles.cos(), radii * angles.sin(), heights], dim=-1).double(), turned.double()


def test_limited_ends_are_within_reach_of_the_rope():
    ends, turned = draw_ends()
    everywhere = torch.ones(len(ends)).double()
    axis, origin = UP.expand(len(ends), 3), ORIGIN.expand(len(ends), 3)
    limited = limit_around_post(ends, turned, 0.8 * everywhere, 0.07 * everywhere, origin, axis)
    moved = angles_between(arms_from_axis(ends, origin, axis), arms_from_axis(limited, origin, axis), axis)
    turned_after = turned + moved[:, 1] - moved[:, 0]
    way, _ = taut_curve(arms_from_axis(limited, origin, axis), turned_after, 0.07 * everywhere, axis)
    rise = limited[:, 1, 2] - limited[:, 0, 2]
    assert (way.square() + rise.square()).sqrt()[(limited != ends).flatten(1).any(1)].max() < 0.8 * 1.02
    before, _ = taut_curve(arms_from_axis(ends, origin, axis), turned, 0.07 * everywhere, axis)
    far = before > 0.8
    assert 0.2 < far.double().mean() < 0.9
    rise = ends[:, 1, 2] - ends[:, 0, 2]
    reached = before.square() + rise.square() <= 0.8**2
    assert torch.equal(limited[reached], ends[reached])
    free = limit_around_post(ends, turned, torch.full_like(turned, torch.inf), 0.07 * everywhere, origin, axis)
    assert torch.equal(free, ends)


def test_limit_turns_with_the_scene():
    ends, turned = draw_ends(50)
    everywhere = torch.ones(len(ends)).double()
    rotation = torch.as_tensor(Rotation.random(random_state=5).as_matrix())
    shift = torch.tensor([1.0, -2.0, 0.5]).double()
    axis, origin = UP.expand(len(ends), 3), ORIGIN.expand(len(ends), 3)
    here = limit_around_post(ends, turned, 0.8 * everywhere, 0.07 * everywhere, origin, axis)
    there = limit_around_post(
        ends @ rotation.T + shift, turned, 0.8 * everywhere, 0.07 * everywhere, origin + shift, axis @ rotation.T
    )
    torch.testing.assert_close(there, here @ rotation.T + shift, atol=1e-9, rtol=0)
