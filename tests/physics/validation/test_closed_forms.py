"""T1 to T13: every simulation against its closed form; equations and derivations stand with the cases."""

from dataclasses import replace

import pytest

from validation import closed_forms, cloth_statics, contact, rope_dynamics, rope_statics

MODULES = [rope_statics, rope_dynamics, cloth_statics, contact]


def as_param(case):
    marks = [pytest.mark.slow] if case.slow else []
    return pytest.param(case, id=str(case), marks=marks)


@pytest.mark.parametrize("case", [as_param(case) for module in MODULES for case in module.CASES])
def test_simulation_agrees_with_its_closed_form(case):
    checks = case.checks()
    assert checks
    for check in checks:
        assert check.holds, check


def test_the_tolerances_would_notice_a_wrong_material():
    """Negative control: 5 % of stretch stiffness and half of bending stiffness do not pass."""
    stretched = next(rope_statics.hanging_rod("T1", num_nodes=21, substeps=20))
    assert not replace(stretched, expected=stretched.expected / 1.05).holds
    for cantilever in (rope_statics.cantilever("T4", gamma=4.0, length=0.5), cloth_statics.sheet_cantilever("T4", gamma=4.0)):
        for check, stiffer in zip(cantilever, closed_forms.heavy_elastica(2.0)[::-1], strict=False):
            assert not replace(check, expected=stiffer).holds
