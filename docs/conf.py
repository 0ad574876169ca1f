"""How Sphinx builds the site; `python -m tools.docs.site` calls it."""

from maniskill_grpd.version import __version__
from tools.docs.docstrings import as_restructured_text

project = "maniskill_grpd"
author = "The maniskill_grpd contributors"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]

# Docstrings are plain English with `names` in single quotes, which are code here whether or not they lead somewhere.
default_role = "literal"
autodoc_typehints = "description"
autodoc_member_order = "bysource"
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_use_ivar = True

html_theme = "furo"
html_title = f"maniskill_grpd {release}"
exclude_patterns = ["files"]


def setup(app) -> None:  # noqa: ANN001, D103
    def process(_app, _what, _name, _item, _options, lines) -> None:  # noqa: ANN001
        lines[:] = as_restructured_text(lines)

    app.connect("autodoc-process-docstring", process, priority=400)  # before napoleon
