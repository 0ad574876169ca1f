"""Simulated wires hang as real ones do, with the stiffness that others have measured, and not with another one."""

import pytest

from .real_wires import wire_errors


@pytest.fixture(scope="module")
def errors():
    return {factor: wire_errors(factor) for factor in (0.3, 1.0, 3.0)}


@pytest.mark.parametrize("wire", ["white", "black", "red"])
def test_wires_hang_as_real_ones_do(errors, wire):
    assert errors[1.0][wire].mean() < 0.02
    assert errors[1.0][wire].mean() < 0.7 * min(errors[0.3][wire].mean(), errors[3.0][wire].mean())
