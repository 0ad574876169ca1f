"""The hash of the source changes with the program, and not with what is said about it."""

import textwrap

import pytest

from maniskill_grpd.runs.source import DECISIVE, PACKAGE, fingerprint_code, source_tokens

PROGRAM = '''
"""A module."""

LIMIT = 2
"""Largest x."""


def double(x):
    """Return twice x."""
    if x > LIMIT:
        return LIMIT
    return 2 * x
'''


def tokens(source):
    return list(source_tokens(textwrap.dedent(source)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""A module."""', '"""Another text\n\nof two paragraphs."""'),
        ('"""Largest x."""', ""),
        ('    """Return twice x."""\n', '    """Say it otherwise."""\n    # and a comment\n\n'),
        ("    return 2 * x", "    return 2*x  # a remark"),
        ("    ", "  "),
    ],
)
def test_words_and_layout_do_not_count(old, new):
    assert old in PROGRAM
    assert tokens(PROGRAM.replace(old, new)) == tokens(PROGRAM)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("2 * x", "3 * x"),
        ("LIMIT = 2", 'LIMIT = "2"'),
        ("        return LIMIT\n    return", "        return LIMIT\n        return"),
        ("x > LIMIT", "x >= LIMIT"),
    ],
)
def test_the_program_does(old, new):
    assert old in PROGRAM
    assert tokens(PROGRAM.replace(old, new)) != tokens(PROGRAM)


@pytest.fixture
def package(tmp_path):
    for name in DECISIVE:
        (tmp_path / name).mkdir()
        (tmp_path / name / "module.py").write_text(PROGRAM)
    return tmp_path


@pytest.mark.parametrize(
    ("path", "counts"),
    [("physics/a.py", True), ("learning/kernels/a.py", True), ("tasks/pictures/a.py", False), ("experiments/a.py", False)],
)
def test_packages_that_decide_a_run_count(package, path, counts):
    before = fingerprint_code(package)
    (package / path).parent.mkdir(parents=True, exist_ok=True)
    (package / path).write_text("x = 1\n")
    fingerprint_code.cache_clear()
    assert (fingerprint_code(package) != before) == counts


def test_versions_of_libraries_count(package, monkeypatch):
    before = fingerprint_code(package)
    fingerprint_code.cache_clear()
    monkeypatch.setattr("maniskill_grpd.runs.source.package_versions", lambda: {"torch": "0"})
    assert fingerprint_code(package) != before


def test_every_package_that_decides_a_run_is_there():
    assert all((PACKAGE / name / "__init__.py").exists() for name in DECISIVE)
    assert fingerprint_code() == fingerprint_code(PACKAGE)
