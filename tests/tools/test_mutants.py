"""The program that tests the tests."""

import pytest
from mutants import MUTANTS, Mutant, StaleMutantError, check

GOOD = Mutant("doubles", "sum.py", "a + b", "a + 2 * b", "test_sum.py")


@pytest.fixture
def tree(tmp_path):
    """Return a tree with a function and tests that see one of its properties only."""
    (tmp_path / "sum.py").write_text("def add(a, b):\n    return a + b\n")
    (tmp_path / "test_sum.py").write_text("from sum import add\n\ndef test_sum():\n    assert add(1, 1) == 2\n")
    return tmp_path


@pytest.mark.parametrize(
    ("mutant", "verdict"),
    [
        (GOOD, "killed"),
        (Mutant("multiplies", "sum.py", "a + b", "2 * a * b", "test_sum.py"), "survived"),
        (Mutant("syntax", "sum.py", "a + b", "a +", "test_sum.py"), "the tests did not run"),
        (Mutant("no test", "sum.py", "a + b", "a", "test_sum.py -k nothing"), "its tests fail without it"),
    ],
)
def test_mutants_are_killed_or_survive(tree, capsys, mutant, verdict):
    before = (tree / "sum.py").read_text()
    assert check([mutant], tree) == (verdict != "killed")
    assert capsys.readouterr().out.startswith(verdict)
    assert (tree / "sum.py").read_text() == before


@pytest.mark.parametrize("change", [{"old": "a - b"}, {"old": "a"}, {"file": "gone.py"}])
def test_stale_entries_are_errors(tree, change):
    with pytest.raises(StaleMutantError, match="expected once"):
        check([Mutant(**(vars(GOOD) | change))], tree)


def test_names_are_unique():
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)
