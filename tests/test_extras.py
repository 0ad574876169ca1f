"""Optional libraries are those of extras, and a missing one says what to install."""

import ast
import re
import sys
from pathlib import Path

import pytest

from maniskill_grpd.extras import MissingExtraError, import_extra

ROOT = Path(__file__).parent.parent


def uses():
    """Return the arguments of all calls of `import_extra` in the package."""
    for path in (ROOT / "maniskill_grpd").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "import_extra":
                yield tuple(ast.literal_eval(argument) for argument in node.args)


def test_a_library_that_is_there_is_returned():
    assert import_extra("json", "x", "this") is sys.modules["json"]


@pytest.mark.parametrize("use", sorted(uses()))
def test_every_extra_that_is_named_installs_the_library(use, monkeypatch):
    tomllib = pytest.importorskip("tomllib")
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    module, extra, purpose = use
    library = module.partition(".")[0]
    assert library in [re.split(r"[><=]", requirement)[0] for requirement in extras[extra]]
    for name in [name for name in sys.modules if name.partition(".")[0] == library]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(MissingExtraError, match=rf"^{purpose} needs {library}.*: pip install 'maniskill-grpd\[{extra}\]'$"):
        import_extra(*use)


def test_the_calls_are_found():
    assert {extra for _, extra, _ in uses()} == {"viewer", "sweep", "track", "pyg", "networkx"}
