"""Links of the pages lead somewhere, and the papers of the project agree with its code."""

import re
from functools import cache
from pathlib import Path
from urllib.parse import unquote

import pytest

from maniskill_grpd.version import __version__

ROOT = Path(__file__).parent.parent
PATTERNS = (
    "*.md",
    "docs/**/*.md",
    *(f"{folder}/**/*.md" for folder in ("baselines", "benchmarks", "checkpoints", "examples", "tools")),
)
NOTES = ROOT / "docs" / "results" / "notes"
"""Parts of the pages one folder above, from which their links are read."""
PAGES = sorted({path for pattern in PATTERNS for path in ROOT.glob(pattern)} - set(NOTES.glob("*.md")))

_FENCE = re.compile(r"^ *(```|~~~).*?^ *\1", re.MULTILINE | re.DOTALL)
_CODE = re.compile(r"`[^`\n]*`")
_LINK = re.compile(r"\]\(\s*<?([^)\s>]+)>?[^)]*\)")
_HEADING = re.compile(r"^#{1,6} +(.*?) *#* *$", re.MULTILINE)


def links(text):
    """Return the targets of the links and images of a page, code left out."""
    return _LINK.findall(_CODE.sub("", _FENCE.sub("", text)))


def anchors(text):
    """Return the anchors that GitHub gives to the headings of a page."""
    found = []
    for heading in _HEADING.findall(_FENCE.sub("", text)):
        shown = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "")
        name = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        found.append(f"{name}-{found.count(name)}" if name in found else name)
    return set(found)


@cache
def anchors_of(path):
    return anchors(path.read_text())


def broken_links(page):
    """Return the relative links of a page that lead to no file or to no heading."""
    broken = []
    for link in links(page.read_text()):
        if re.match(r"[a-z]+:", link):
            continue
        place, _, anchor = link.partition("#")
        target = (page.parent / unquote(place)).resolve() if place else page
        if not target.exists() or (anchor and target.suffix == ".md" and anchor not in anchors_of(target)):
            broken.append(link)
    return broken


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_relative_links_lead_to_files_and_headings(page):
    assert broken_links(page) == []


def test_a_link_that_leads_nowhere_is_found(tmp_path):
    (tmp_path / "other.md").write_text("# A `b` c!\n\n## Twice\n\n## Twice\n")
    page = tmp_path / "page.md"
    page.write_text(
        "# Here\n[1](other.md) [2](other.md#a-b-c) [3](#here) ![4](x.png) [5](other.md#no) `[6](code.md)`\n"
        "```\n[7](code.md)\n```\n[8](https://example.org) [9](#there) [10](other.md#twice-1)\n"
    )
    assert broken_links(page) == ["x.png", "other.md#no", "#there"]


def test_the_programs_of_the_page_about_materials_run():
    pytest.importorskip("mani_skill")
    programs = re.findall(r"^```python\n(.*?)^```", (ROOT / "docs" / "own_material.md").read_text(), re.MULTILINE | re.DOTALL)
    assert len(programs) == 3
    for program in programs:
        exec(program, {})


def test_the_citation_has_the_version_of_the_package_and_names_the_paper_as_the_readme_does():
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {__version__}\n" in citation
    title = re.search(r"- type: article\n +title: >-\n +(.*)\n", citation).group(1)
    first_paragraph = (ROOT / "README.md").read_text().split("\n\n")[1]
    assert title in " ".join(first_paragraph.split())
    for name in ("Graph-Reinforced Policy for Deformables", "Bounded Policy Projection"):
        assert name in " ".join(first_paragraph.split())
