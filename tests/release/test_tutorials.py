"""What tutorials tell readers to type runs as it is written there, with sizes that take seconds."""

import glob
import re
import shlex
import shutil
import sys
from pathlib import Path

import pytest

pytest.importorskip("mani_skill")

from maniskill_grpd.commands import main
from maniskill_grpd.program import PROGRAM

pytestmark = pytest.mark.release

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*(DOCS / "tutorials").glob("*.md"), DOCS / "own_task.md"])
PROGRAMS = [*PAGES, DOCS / "learners.md", DOCS / "cameras.md"]
"""Pages whose blocks of Python are whole programs."""

SMALL = {
    "--total_timesteps": lambda value: str(int(value.replace("_", "")) // 5000),
    "--num_episodes": lambda _: "2",
    "--jobs": lambda _: "1",
}
"""Smaller sizes of what the pages ask for, by option: of steps a five thousandth, so that resuming still goes on."""
TRAINING = shlex.split("--num_envs 2 --num_steps 10 --num_minibatches 1 --update_epochs 1 --num_eval_envs 2 --no_capture_video")
ALSO = {
    "train": TRAINING,
    "clone": shlex.split("--epochs 1 --num_test_episodes 2 --num_steps 10"),
    "sweep": TRAINING,
    "evaluate": ["--num_envs", "2"],
    "evaluate_expert": ["--num_envs", "2"],
    "record": ["--num_envs", "2"],
}
"""What is typed beside, by command."""


def commands(page):
    """Return the commands of this program on a page, in order, as lists of words."""
    blocks = re.findall(r"^```sh\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    lines = [re.sub(rf"^({PROGRAM}|python -m maniskill_grpd) ", "", line) for line in "".join(blocks).splitlines()]
    return [shlex.split(line, comments=True) for line in lines]


def programs(page):
    """Return the whole programs on a page: those that import what they use."""
    blocks = re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)
    return [block for block in blocks if block.startswith(("import ", "from "))]


def small(words):
    """Return a command that does the same in seconds, and in which patterns are the files they mean, as in a shell."""
    words = [file for word in words for file in (sorted(glob.glob(word)) or [word])]
    words = [re.sub(r"^seed=1,.*", "seed=1", word) for word in words]
    words = [SMALL[before](word) if before in SMALL else word for before, word in zip(["", *words], words, strict=False)]
    extra = [] if "--resume" in words else ALSO.get(words[0], [])
    return [*words, *extra]


@pytest.fixture
def empty_folder(tmp_path, monkeypatch):
    """Work in a folder that holds nothing but the file of the page about own tasks, where Python finds it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    shutil.copy(ROOT / "examples" / "own_task.py", tmp_path)
    yield tmp_path
    sys.modules.pop("own_task", None)


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=lambda page: page.stem)
def test_the_commands_of_a_page_run(page, empty_folder, capsys):
    for words in commands(page):
        assert main(small(words)) == 0, f"{shlex.join(words)}\n{capsys.readouterr().err}"


@pytest.mark.parametrize("page", [page for page in PROGRAMS if programs(page)], ids=lambda page: page.stem)
def test_the_programs_of_a_page_run(page, empty_folder):
    for program in programs(page):
        exec(program, {})


def test_every_tutorial_has_something_that_is_run():
    assert {page.stem for page in PAGES if commands(page) or programs(page)} == {page.stem for page in PAGES}
    assert sum(len(commands(page)) for page in PAGES) >= 14
