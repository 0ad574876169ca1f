"""Errors of depth sensors: closed forms, and independence of the batch."""

import pytest
import torch

from maniskill_grpd.rendering import DepthSensor
from maniskill_grpd.rendering.sensor_noise import draw_normal, draw_uniform

SEEDS = torch.tensor([3, 4, 5], dtype=torch.int32)


def plane(depth, side=80):
    return torch.full((3, side, side), depth)


@pytest.mark.parametrize("depth", [0.5, 2.0])
def test_noise_grows_with_the_square_of_the_depth(depth):
    measured = DepthSensor(noise=0.001).measure(plane(depth), SEEDS)
    assert measured.std() == pytest.approx(0.001 * depth**2, rel=0.05)
    assert measured.mean() == pytest.approx(depth, rel=1e-4)


def test_steps_are_steps_of_the_inverse_depth():
    depth = torch.linspace(0.5, 3.0, 300).expand(3, 1, 300)
    measured = DepthSensor(step=0.02).measure(depth, SEEDS)
    steps = 1.0 / measured / 0.02
    torch.testing.assert_close(steps, steps.round(), atol=1e-3, rtol=0.0)
    assert (1.0 / measured - 1.0 / depth).abs().max() <= 0.01 + 1e-6


def test_dropout_loses_its_share_and_nothing_stays_nothing():
    depth = plane(1.0)
    depth[:, :40] = 0.0
    measured = DepthSensor(dropout=0.3, noise=0.01).measure(depth, SEEDS)
    assert (measured[:, :40] == 0.0).all()
    assert (measured[:, 40:] == 0.0).float().mean() == pytest.approx(0.3, abs=0.03)


def test_what_is_too_far_for_a_step_is_not_found():
    assert (DepthSensor(step=1.0).measure(plane(10.0), SEEDS) == 0.0).all()


def test_an_exact_sensor_changes_nothing_but_rounding():
    depth = plane(0.7) + torch.rand(3, 80, 80)
    torch.testing.assert_close(DepthSensor().measure(depth, SEEDS), depth)


def test_errors_of_a_world_follow_from_its_seed_alone():
    sensor, depth = DepthSensor(noise=0.01, dropout=0.1), plane(1.0)
    together = sensor.measure(depth, SEEDS)
    alone = sensor.measure(depth[:1], SEEDS[1:2].contiguous())
    assert torch.equal(together[1], alone[0])
    assert not torch.equal(together[0], together[1])


def test_numbers_have_the_distributions_they_are_named_for():
    normal, uniform = draw_normal(SEEDS, 50, 100), draw_uniform(SEEDS, 5000)
    assert normal.shape == (3, 50, 100)
    assert normal.mean().abs() < 0.03
    assert normal.std() == pytest.approx(1.0, abs=0.03)
    assert normal.abs().max() > 3.0
    assert uniform.min() >= 0.0
    assert uniform.max() < 1.0
    assert uniform.std() == pytest.approx(12.0**-0.5, abs=0.01)
    assert torch.corrcoef(normal.flatten(1)).fill_diagonal_(0.0).abs().max() < 0.05


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"noise": -1.0}, r"noise of a depth sensor must be in \[0, inf\), got -1.0"),
        ({"dropout": 1.0}, r"dropout of a depth sensor must be in \[0, 1\), got 1.0"),
        ({"step": float("nan")}, "step of a depth sensor"),
        ({"blur": 1.0}, r"any of \['noise', 'step', 'dropout'\]"),
        (0.1, "must be a mapping"),
    ],
)
def test_impossible_sensors_are_refused(settings, message):
    with pytest.raises(ValueError, match=message):
        DepthSensor.from_mapping(settings)
