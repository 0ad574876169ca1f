"""Noise of a given spectrum: variance one at every step, neighbours as alike as the exponent says."""

import pytest
import torch

from maniskill_grpd.planning.colored_noise import colored_noise


def draw(exponent, steps=16, num=20_000):
    return colored_noise(num, steps, 1, exponent, torch.Generator().manual_seed(0))[..., 0]


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, 4.0])
@pytest.mark.parametrize("steps", [1, 2, 3, 16])
def test_every_step_has_mean_zero_and_variance_one(exponent, steps):
    noise = draw(exponent, steps)
    torch.testing.assert_close(noise.mean(dim=0), torch.zeros(steps), atol=0.04, rtol=0)
    torch.testing.assert_close(noise.var(dim=0), torch.ones(steps), atol=0.05, rtol=0)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, 3.0])
def test_neighbours_correlate_as_the_spectrum_says(exponent):
    """Wiener-Khinchin: the correlation at a lag is the cosine transform of the power of the period, 32 here."""
    noise = draw(exponent)
    waves = torch.arange(17, dtype=torch.float64)
    power = waves.clamp(min=1.0) ** -exponent
    power[1:-1] *= 2.0
    for lag in (1, 4, 15):
        expected = (power * torch.cos(2.0 * torch.pi * waves * lag / 32)).sum() / power.sum()
        found = (noise[:, 0] * noise[:, lag]).mean()
        assert found.item() == pytest.approx(expected.item(), abs=0.03)


def test_equal_seeds_give_equal_noise_and_components_are_independent():
    one, other = (colored_noise(5_000, 8, 2, 2.0, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(one, other)
    assert (one[..., 0] * one[..., 1]).mean(dim=0).abs().max() < 0.05
