"""Pages of the site lead where the pages of the repository do."""

import re
from urllib.parse import unquote

import pytest

pytest.importorskip("mani_skill")

from tests.test_documents import anchors, links
from tools.docs.site import DOCS, ROOT, Links, sources, stage


@pytest.fixture(scope="module")
def staged(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    stage(folder)
    return folder


def turned(text, page="docs/results/README.md", place="results/README.md"):
    return Links(ROOT / page, place).turned(text)


@pytest.mark.parametrize(
    ("link", "result"),
    [
        ("[a](../physics.md#contact-with-itself)", "[a](../physics.md#contact-with-itself)"),
        ("[a](../../README.md)", "[a](../index.md)"),
        ("[a](../../baselines/README.md#train)", "[a](../commands.md#train)"),
        ("[a](../../examples/own_task.py)", "[a](../files/examples/own_task.py)"),
        ("[a](../../maniskill_grpd/physics)", "a"),
        ("[a](../replays/RopeShaping-v1_expert.html)", '<a href="../replays/RopeShaping-v1_expert.html">a</a>'),
        ("![a](../images/tasks.gif)", "![a](../images/tasks.gif)"),
        ("[a](https://example.org) [b](#here)", "[a](https://example.org) [b](#here)"),
        ("```\n[a](../../README.md)\n```", "```\n[a](../../README.md)\n```"),
    ],
)
def test_links_are_turned(link, result):
    assert turned(link) == result


def test_pages_from_beside_the_folder_lead_back_into_it():
    assert turned("[a](../docs/ppo.md)", "baselines/README.md", "commands.md") == "[a](ppo.md)"
    assert turned("[a](docs/ppo.md)", "CHANGELOG.md", "changelog.md") == "[a](ppo.md)"


def test_links_of_the_site_lead_to_files_and_headings(staged):
    replays = {f"replays/{path.name}" for path in (DOCS / "replays").glob("*.html")}
    broken = []
    for page in sorted(staged.rglob("*.md")):
        text = page.read_text()
        for link in [*links(text), *re.findall(r'<a href="([^"]*)"', text)]:
            place, _, anchor = link.partition("#")
            target = (page.parent / unquote(place)).resolve() if place else page
            if re.match(r"[a-z]+:", link) or target.relative_to(staged.resolve()).as_posix() in replays:
                continue
            if not target.exists() or (anchor and anchor not in anchors(target.read_text())):
                broken.append((page.relative_to(staged), link))
    assert broken == []


def test_every_page_has_its_place_in_the_contents(staged):
    """What no table of contents names cannot be found."""
    named = set()
    for page in staged.rglob("*.md"):
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(), re.DOTALL):
            for entry in [line for line in block.splitlines() if line and not line.startswith(":")]:
                named |= {path.resolve() for path in page.parent.glob(f"{entry}.md")}
    pages = {path.resolve() for path in staged.rglob("*.md")}
    assert pages - named == {(staged / "index.md").resolve()}
    assert {path.resolve() for path in (DOCS / "tutorials").glob("*.md")} <= {path.resolve() for path in sources().values()}
