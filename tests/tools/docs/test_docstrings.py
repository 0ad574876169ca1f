"""Docstrings in plain English become reStructuredText that says the same."""

import pytest

from tools.docs.docstrings import as_restructured_text


def converted(text):
    return "\n".join(as_restructured_text(text.splitlines()))


@pytest.mark.parametrize(
    ("plain", "markup"),
    [
        ("the length |x| of a * b", r"the length \|x\| of a \* b"),
        ("**bold** stays, `a * |b|` is code", "**bold** stays, `a * |b|` is code"),
        ("two `Model`s", r"two `Model`\ s"),
    ],
)
def test_signs_are_themselves(plain, markup):
    assert converted(plain) == markup


def test_what_is_indented_stands_as_it_is():
    assert (
        converted("Shapes:\n    a  (B, |N|)\n       mask\n\nMore.") == "Shapes:\n\n::\n\n    a  (B, |N|)\n       mask\n\n\nMore."
    )


def test_a_list_is_apart_from_what_is_above_it_and_its_lines_go_on():
    assert converted("Draws:\n- one\n  and more\n- two") == "Draws:\n\n- one\n  and more\n- two"


def test_sections_are_left_to_napoleon():
    text = "What.\n\nArgs:\n    a: One,\n        and more."
    assert converted(text) == text
