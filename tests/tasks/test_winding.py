"""Winding numbers against closed forms, and taut curves against the shortest ones."""

import math

import pytest
import torch

from maniskill_grpd.tasks.geometry.post_leash import limit_around_post, taut_length
from maniskill_grpd.tasks.geometry.winding import angles_between, winding_number


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


def taut(first, second, turned, radius=0.1):
    values = (torch.tensor(value, dtype=torch.float64) for value in ([[first, second]], [turned], [radius]))
    return taut_length(*values).item()


@pytest.mark.parametrize(
    ("first", "second", "turned", "expected"),
    [
        (0.1, 0.1, 3.0, 0.3),  # an arc alone
        (0.1, 0.1, 7.0, 0.7),
        (0.05, 0.1, 3.0, 0.3),  # an end within the disc counts as one on its rim
        (0.2, 0.2, math.pi, 2 * 0.03**0.5 + 0.1 * math.pi / 3),  # two tangents, 60 degrees each
        (0.2, 0.2, 2.0, 0.0),  # a chord that passes the disc
    ],
)
def test_taut_curves_have_the_length_of_tangents_and_arc(first, second, turned, expected):
    assert taut(first, second, turned) == pytest.approx(expected, abs=1e-12)


def test_taut_curves_are_the_shortest_ones():
    """Against polylines whose inner nodes are free to move along rays from the origin, down to the disc's rim."""
    first, second, turned, radius, num = 0.3, 0.25, 4.0, 0.1, 400
    angles = torch.linspace(0.0, turned, num, dtype=torch.float64)
    # The distance of a tangent from the origin at an angle from its point of contact is radius / cos(angle).
    contact = [math.acos(radius / first), turned - math.acos(radius / second)]
    distances = torch.full((num,), radius, dtype=torch.float64)
    for contact_angle, on_tangent in zip(contact, (angles < contact[0], angles > contact[1]), strict=True):
        distances = torch.where(on_tangent, radius / (angles - contact_angle).cos(), distances)

    def length(distances):
        points = torch.stack([distances * angles.cos(), distances * angles.sin()], dim=-1)
        return points.diff(dim=0).norm(dim=-1).sum().item()

    assert length(distances) == pytest.approx(taut(first, second, turned), rel=1e-5)
    generator = torch.Generator().manual_seed(0)
    for _ in range(50):
        inner = (torch.rand(num, generator=generator).double() - 0.5).cumsum(0) * 0.005
        inner[[0, -1]] = 0.0
        assert length((distances + inner).clamp(min=radius)) > length(distances)


def draw_ends(num=500):
    generator = torch.Generator().manual_seed(0)
    distances = 0.08 + torch.rand(num, 2, generator=generator)
    turned = 12.0 * torch.rand(num, generator=generator) - 6.0
    start = 6.0 * torch.rand(num, generator=generator)
    angles = torch.stack([start, start + turned], dim=1)
    heights = 0.3 * torch.rand(num, 2, generator=generator)
    return torch.stack([distances * angles.cos(), distances * angles.sin(), heights], dim=-1), turned


def way_around(ends, turned):
    """Return the length of the taut rope between ends, (B,)."""
    across = taut_length(ends[..., :2].norm(dim=-1), turned.abs(), torch.full_like(turned, 0.07))
    return torch.hypot(across, ends[:, 1, 2] - ends[:, 0, 2])


def test_limited_ends_are_within_reach_of_the_rope():
    ends, turned = draw_ends(5000)
    length, radius = torch.full_like(turned, 0.8), torch.full_like(turned, 0.07)
    limited = limit_around_post(ends, turned, length, radius)
    moved = angles_between(ends[..., :2], limited[..., :2])
    way, is_around = way_around(ends, turned), taut_length(ends[..., :2].norm(dim=-1), turned.abs(), radius) > 0.0
    assert torch.equal(limited[~is_around | (way <= 0.8)], ends[~is_around | (way <= 0.8)])
    is_a_step_too_far = is_around & (way > 0.8) & (way < 0.86)  # each gripper moves by 3 cm at most
    assert is_a_step_too_far.sum() > 50
    torch.testing.assert_close(
        way_around(limited, turned + moved[:, 1] - moved[:, 0])[is_a_step_too_far], length[is_a_step_too_far], atol=1e-5, rtol=0
    )
    assert torch.equal(limit_around_post(ends, turned, torch.full_like(turned, torch.inf), radius), ends)


def test_both_ends_give_way_by_the_same_amount_along_the_taut_rope():
    ends = torch.tensor([[[0.3, 0.0, 0.0], [-0.3, 0.0, 0.0]]], dtype=torch.float64)
    turned, radius = torch.tensor([math.pi], dtype=torch.float64), torch.tensor([0.1], dtype=torch.float64)
    way = taut_length(ends[..., :2].norm(dim=-1), turned, radius)
    moved = limit_around_post(ends, turned, way - 1e-4, radius) - ends
    # Counter-clockwise over the top; the tangents meet the ends at asin(0.1 / 0.3) from the line to the axis.
    sine, cosine = 1 / 3, 8**0.5 / 3
    expected = 0.5e-4 * torch.tensor([[[-cosine, sine, 0.0], [cosine, sine, 0.0]]], dtype=torch.float64)
    torch.testing.assert_close(moved, expected, atol=1e-7, rtol=0)
    clockwise = limit_around_post(ends, -turned, way - 1e-4, radius) - ends
    torch.testing.assert_close(clockwise, expected * torch.tensor([1.0, -1.0, 1.0]), atol=1e-7, rtol=0)
