"""Exploration noise that is correlated in time."""

import dataclasses
import math

import pytest
import torch
from toy_run import CONFIG, make_toy_trainer

from maniskill_grpd.learning.action_noise import ActionNoise
from maniskill_grpd.learning.checkpoint import load_checkpoint
from maniskill_grpd.policies import ActionDistribution

SAMPLES = 20_000
LIKE = torch.zeros(SAMPLES, 1, 1)


def draw(correlation, steps):
    """Draw noise (steps, SAMPLES) of independent sequences."""
    noise, generator = ActionNoise(correlation), torch.Generator().manual_seed(0)
    return torch.stack([noise.draw(LIKE, generator).flatten() for _ in range(steps)])


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_every_step_is_standard_normal_and_steps_are_correlated_as_asked(correlation):
    noise = draw(correlation, 6)
    # Standard errors: mean 1 / sqrt(n), variance sqrt(2 / n), correlation at most 1 / sqrt(n); five of them.
    error = 5.0 / math.sqrt(SAMPLES)
    assert noise.mean(dim=1).abs().max() < error
    assert (noise.var(dim=1) - 1.0).abs().max() < math.sqrt(2.0) * error
    for lag in range(1, 6):
        found = (noise[0] * noise[lag]).mean().item()
        assert found == pytest.approx(correlation**lag, abs=math.sqrt(2.0) * error)


def test_correlated_noise_carries_further():
    steps, correlation = 200, 0.8
    ratio = draw(correlation, steps).sum(dim=0).std() / draw(0.0, steps).sum(dim=0).std()
    expected = math.sqrt((1 + correlation) / (1 - correlation))
    # Ends of the sequence: relative 2 c / (n (1 - c^2)) of the variance; sampling: 1 / sqrt(2 n) each.
    assert ratio.item() == pytest.approx(expected, rel=0.03)


def test_after_a_restart_noise_knows_nothing_of_the_past():
    noise, generator = ActionNoise(0.99), torch.Generator().manual_seed(0)
    before = noise.draw(LIKE, generator)
    noise.restart()
    after = noise.draw(LIKE, generator)
    assert abs((before * after).mean().item()) < 5.0 / math.sqrt(SAMPLES)


def test_without_correlation_actions_are_those_of_independent_samples():
    mean = torch.randn(5, 2, 3)
    dist = ActionDistribution(mean, torch.full((5, 2, 1), 0.3), torch.ones(5, 2, dtype=torch.bool))
    one, other = (torch.Generator().manual_seed(3) for _ in range(2))
    noise = ActionNoise(0.0)
    for _ in range(3):
        assert torch.equal(dist.sample(one, noise.draw(mean, one)), dist.sample(other))


def test_a_resumed_run_with_correlated_noise_ends_bit_for_bit_like_an_unbroken_one(tmp_path):
    config = dataclasses.replace(CONFIG, noise_correlation=0.8, anneal_lr=False, total_timesteps=8 * 7 * 6)
    half = dataclasses.replace(config, total_timesteps=8 * 7 * 3)
    make_toy_trainer(tmp_path / "whole", config).train()
    make_toy_trainer(tmp_path / "broken", half).train()
    resumed = make_toy_trainer(tmp_path / "broken", config)
    resumed.load(tmp_path / "broken" / "last.pt")
    resumed.train()
    weights = [load_checkpoint(tmp_path / run / "final_ckpt.pt")["weights"] for run in ("whole", "broken")]
    for name, tensor in weights[0].items():
        assert torch.equal(tensor, weights[1][name]), name


@pytest.mark.parametrize("value", [-0.1, 1.0, math.nan])
def test_impossible_correlations_are_refused(value):
    with pytest.raises(ValueError, match="noise_correlation must lie in"):
        dataclasses.replace(CONFIG, noise_correlation=value)


def test_the_schedule_takes_the_correlation_to_zero():
    config = dataclasses.replace(CONFIG, noise_correlation=0.8, noise_schedule="linear")
    values = [config.coefficients(i).noise_correlation for i in range(config.num_iterations + 1)]
    assert values[0] == 0.8
    assert values[-1] == 0.0
    assert all(late < early for early, late in zip(values, values[1:], strict=False))


def test_a_schedule_without_correlation_is_refused():
    with pytest.raises(ValueError, match="--noise_schedule changes --noise_correlation"):
        dataclasses.replace(CONFIG, noise_schedule="linear")
