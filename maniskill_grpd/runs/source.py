"""The source that decides what a run computes, as one hash."""

from __future__ import annotations

import functools
import hashlib
import io
import tokenize
from collections.abc import Iterator
from pathlib import Path

from maniskill_grpd.runs.versions import package_versions

DECISIVE = ("physics", "agents", "tasks", "graphs", "policies", "learning")
"""Packages whose source decides what a run computes."""
INDECISIVE = ("tasks/pictures",)
"""Folders in them that do not."""
PACKAGE = Path(__file__).parent.parent

_DEPTH = {tokenize.INDENT: "{", tokenize.DEDENT: "}", tokenize.NEWLINE: ";"}
"""How tokens of layout that mean something are written, whatever they are made of."""
_SILENT = {tokenize.COMMENT, tokenize.NL, tokenize.ENCODING, tokenize.ENDMARKER}


@functools.cache
def fingerprint_code(package: Path = PACKAGE) -> str:
    """Hash the source that decides a run, token by token, and the versions of the libraries."""
    total = hashlib.sha256()
    for path in sorted(path for name in DECISIVE for path in (package / name).rglob("*.py")):
        place = path.relative_to(package).as_posix()
        if not place.startswith(INDECISIVE):
            total.update(f"\n{place}\n{' '.join(source_tokens(path.read_text(encoding='utf-8')))}".encode())
    total.update(repr(sorted(package_versions().items())).encode())
    return total.hexdigest()[:16]


def source_tokens(source: str) -> Iterator[str]:
    """Yield the tokens of a Python source without comments, docstrings and spaces."""
    tokens = [token for token in tokenize.generate_tokens(io.StringIO(source).readline) if token.type not in _SILENT]
    is_docstring = False
    for previous, token, following in zip([None, *tokens[:-1]], tokens, [*tokens[1:], None], strict=True):
        ends_docstring, is_docstring = is_docstring, _stands_alone(previous, token, following)
        if token.type in _DEPTH and not ends_docstring:
            yield _DEPTH[token.type]
        elif token.type not in _DEPTH and not is_docstring:
            yield token.string


def _stands_alone(previous: tokenize.TokenInfo | None, token: tokenize.TokenInfo, following: tokenize.TokenInfo | None) -> bool:
    """Return whether a token is a string that is a whole statement."""
    begins = previous is None or previous.type in _DEPTH
    return token.type == tokenize.STRING and begins and following is not None and following.type == tokenize.NEWLINE
