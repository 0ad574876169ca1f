"""T1 to T13: every simulation against its closed form; equations and derivations stand with the cases."""

import pytest

from validation import cloth_statics, contact, rope_dynamics, rope_statics

MODULES = [rope_statics, rope_dynamics, cloth_statics, contact]


def as_param(case):
    marks = [pytest.mark.slow] if case.slow else []
    if case.fails_because:
        marks.append(pytest.mark.xfail(reason=case.fails_because, strict=True))
    return pytest.param(case, id=str(case), marks=marks)


@pytest.mark.parametrize("case", [as_param(case) for module in MODULES for case in module.CASES])
def test_simulation_agrees_with_its_closed_form(case):
    checks = case.checks()
    assert checks
    for check in checks:
        assert check.holds, check
