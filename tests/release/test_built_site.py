"""The site is built without a warning, and its links to other servers lead somewhere."""

import re
import subprocess
import sys
import urllib.error
import urllib.request

import pytest

pytest.importorskip("mani_skill")

from tests.test_documents import PAGES, links
from tools.docs.site import ROOT

ADDRESSES = sorted({link for page in PAGES for link in links(page.read_text()) if re.match(r"https?:", link)})


@pytest.mark.release
def test_the_site_is_built_without_warnings(tmp_path):
    pytest.importorskip("furo", reason="extra docs")
    program = "import sys; from pathlib import Path; from tools.docs.site import build; sys.exit(build(Path(sys.argv[1])))"
    result = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "site")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    pages = {path.relative_to(tmp_path / "site" / "html").as_posix() for path in tmp_path.rglob("*.html")}
    assert {"index.html", "api/physics.html", "tutorials/first_policy.html", "replays/ClothFolding-v1_expert.html"} <= pages
    physics = (tmp_path / "site" / "html" / "api" / "physics.html").read_text()
    for name in ("maniskill_grpd.physics.Solver.step", "maniskill_grpd.physics.cloth_from_mesh"):
        assert f'id="{name}"' in physics


@pytest.mark.external
@pytest.mark.parametrize("address", ADDRESSES)
def test_links_to_other_servers_lead_somewhere(address):
    request = urllib.request.Request(address, headers={"User-Agent": "Mozilla/5.0"})
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            status = answer.status
    except urllib.error.HTTPError as error:
        status = error.code  # a server may refuse programs, but has to know the page
    assert status not in (404, 410)
