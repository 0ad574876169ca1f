"""Gaussian noise whose power falls with frequency: neighbouring steps of a plan are alike."""

from __future__ import annotations

import torch


def colored_noise(num: int, steps: int, dims: int, exponent: float, generator: torch.Generator) -> torch.Tensor:
    """Draw noise with a power spectrum f^-exponent along its steps (Timmer & Koenig 1995).

    White noise moves a gripper back and forth about where it is; what a plan needs are motions that go on for a while (Pinneri et
    al. 2020, iCEM). A period of twice the steps is drawn and half of it is given, or the last step would be tied to the first.

    Args:
        num: Number of independent series.
        steps: Steps of each.
        dims: Independent components of each.
        exponent: Of the spectrum: 0 for white noise, 2 for a random walk.
        generator: Source of randomness, on the CPU.

    Returns:
        (num, steps, dims), each number with mean 0 and variance 1.
    """
    period = 2 * steps
    frequencies = torch.fft.rfftfreq(period)
    frequencies[0] = frequencies[1]  # a mean that is drawn too, with the power of the slowest wave
    amplitude = frequencies ** (-exponent / 2.0)
    parts = torch.randn(2, num, dims, period // 2 + 1, generator=generator)
    parts[1, ..., [0, -1]] = 0.0  # the mean and the fastest wave have no phase
    weights = torch.full_like(amplitude, 2.0)
    parts[0, ..., [0, -1]] *= 2.0**0.5
    weights[[0, -1]] = 1.0
    power = (weights * amplitude.square()).sum() * 2.0 / period**2
    series = torch.fft.irfft(torch.complex(parts[0], parts[1]) * amplitude, n=period)
    return (series / power.sqrt())[..., :steps].transpose(1, 2).contiguous()
