"""Build the site: `python -m tools.docs.site`, the last part of `make docs`; it lies in build/site/html.

Pages are written for readers of the repository and stay as they are. Here they are copied to build/site/source together with
those that lie beside docs/ (`BESIDE`), and links that leave docs/ are turned to where their target lies on the site (`Links`).
Every warning of Sphinx is an error.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
BUILD = ROOT / "build" / "site"
BESIDE = {
    "README.md": "index.md",
    "docs/README.md": "index.md",
    "baselines/README.md": "commands.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    **{f"checkpoints/{path.name}": f"checkpoints/{path.name}" for path in sorted((ROOT / "checkpoints").glob("*.md"))},
}
"""Places on the site of pages that lie beside docs/; the site has a first page of its own in place of the README."""
SHOWN = (".md", ".png", ".gif", ".jpg")
"""Files of docs/ that are on the site at the same place."""
ATTACHED = (".py", ".json", ".csv", ".sh", ".cff")
"""Files that a page may hand out."""

_CODE = re.compile(r"^( *)(```|~~~).*?^\1\2 *$", re.MULTILINE | re.DOTALL)
_LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\[\]]*)\]\(\s*(?P<target>[^)\s]+)\s*\)")


class Links:
    """Turns the links of one page to where their targets lie on the site.

    Attributes:
        attachments: Files of the repository, by their place on the site, that have to be copied there.
    """

    def __init__(self, page: Path, place: str) -> None:
        """Take a page.

        Args:
            page: Its file in the repository.
            place: Where it lies on the site.
        """
        self._page = page
        self._folder = Path(place).parent
        self.attachments: dict[str, Path] = {}

    def turned(self, text: str) -> str:
        """Return the text with its links turned; blocks of code are left alone."""
        parts, start = [], 0
        for code in _CODE.finditer(text):
            parts += [_LINK.sub(self._turn, text[start : code.start()]), code.group()]
            start = code.end()
        return "".join([*parts, _LINK.sub(self._turn, text[start:])])

    def _turn(self, link: re.Match[str]) -> str:
        place, _, anchor = link["target"].partition("#")
        if not place or re.match(r"[a-z]+:", place):
            return link.group()
        target = (self._page.parent / place).resolve()
        inside = target.relative_to(ROOT).as_posix()
        if target.suffix == ".html" and target.is_relative_to(DOCS):  # as it is: Sphinx would offer it for download
            return f'<a href="{self._relative(target.relative_to(DOCS).as_posix())}">{link["text"]}</a>'
        if inside in BESIDE:
            place = BESIDE[inside]
        elif target.is_relative_to(DOCS) and target.suffix in SHOWN:
            place = target.relative_to(DOCS).as_posix()
        elif target.suffix in ATTACHED:
            place, anchor = f"files/{inside}", ""
            self.attachments[place] = target
        else:
            return link["text"]
        anchor = f"#{anchor}" if anchor else ""
        return f"{link['image']}[{link['text']}]({self._relative(place)}{anchor})"

    def _relative(self, place: str) -> str:
        return Path(os.path.relpath(place, self._folder)).as_posix()


def stage(folder: Path) -> None:
    """Copy all that the site is made of into an empty folder, links turned."""
    shutil.copy(DOCS / "conf.py", _made(folder / "conf.py"))
    for name, page in sources().items():
        if page.suffix != ".md":
            shutil.copy(page, _made(folder / name))
            continue
        links = Links(page, name)
        _made(folder / name).write_text(links.turned(page.read_text(encoding="utf-8")), encoding="utf-8")
        for place, file in links.attachments.items():
            shutil.copy(file, _made(folder / place))


def sources() -> dict[str, Path]:
    """Return the files of the site by their place on it."""
    notes = DOCS / "results" / "notes"  # parts of other pages
    own = (path for path in sorted(DOCS.rglob("*")) if path.suffix in SHOWN and notes not in path.parents)
    beside = {place: ROOT / name for name, place in BESIDE.items() if place != "index.md"}
    return {path.relative_to(DOCS).as_posix(): path for path in own} | beside


def build(folder: Path = BUILD) -> int:
    """Build the site anew in a folder of its own; return the exit code of Sphinx."""
    shutil.rmtree(folder, ignore_errors=True)
    stage(folder / "source")
    shutil.copytree(DOCS / "replays", _made(folder / "html" / "replays"), ignore=shutil.ignore_patterns("*.json"))
    words = ["-m", "sphinx", "--fail-on-warning", "--keep-going", "--quiet", "-b", "html"]
    result = subprocess.run([sys.executable, *words, str(folder / "source"), str(folder / "html")], check=False)
    if result.returncode == 0:
        print(folder / "html" / "index.html")
    return result.returncode


def _made(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    return path


if __name__ == "__main__":
    sys.exit(build())
