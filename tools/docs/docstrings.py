"""Docstrings of the package as Sphinx reads them."""

from __future__ import annotations

import re

SECTION = re.compile(r"(Args|Attributes|Returns|Yields|Raises):$")
"""Where the part of a docstring begins that napoleon reads."""
BULLET = re.compile(r"[-*] ")


def as_restructured_text(lines: list[str]) -> list[str]:
    """Return a docstring in plain English and Markdown lists as reStructuredText.

    What is indented below a line that is no bullet is shown as it stands; `|x|` and a single `*` are not markup.
    """
    result: list[str] = []
    above, literal, sections = "", None, False
    for line in lines:
        depth = len(line) - len(line.lstrip())
        sections = sections or SECTION.match(line) is not None
        if literal is not None and line.strip() and depth < literal:
            literal = None
            result.append("")
        is_list = BULLET.match(line.lstrip()) is not None
        if literal is None and line.strip() and not sections:
            indented = depth > len(above) - len(above.lstrip())
            in_list = BULLET.match(above.lstrip()) is not None
            if indented and not in_list:
                literal = depth
                result += ["", "::", ""]
            elif is_list and not in_list:
                result.append("")
        result.append(line if literal is not None else _escaped(line))
        # Lines that go on with a bullet are indented as its text is, and count as it.
        if line.strip() and not (BULLET.match(above.lstrip()) and depth > 0 and not is_list):
            above = line
    return result


def _escaped(line: str) -> str:
    """Return a line in which bars and single stars are themselves, and a letter may follow code."""
    parts = re.split(r"(`[^`]*`)", line)
    plain = (part if part.startswith("`") else re.sub(r"\||(?<!\*)\*(?!\*)", r"\\\g<0>", part) for part in parts)
    return re.sub(r"(`[^`]*`)(?=\w)", r"\1\\ ", "".join(plain))
