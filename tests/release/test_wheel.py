"""What is built installs in an empty environment and works from an empty folder."""

import os
import site
import subprocess
import sys
import sysconfig
import tarfile
import zipfile
from email.parser import HeaderParser
from pathlib import Path

import pytest
from packaging.specifiers import SpecifierSet

pytestmark = pytest.mark.release
pytest.importorskip("mani_skill")
pytest.importorskip("build", reason="extra release")
pytest.importorskip("twine", reason="extra release")

ROOT = Path(__file__).parents[2]
EXTRAS = {"viewer", "sb3", "pyg", "networkx", "newton", "sweep", "track", "docs", "test", "release"}
MAKE_ALL = """
import gymnasium as gym
import maniskill_grpd
from maniskill_grpd.experts import EXPERTS

print(maniskill_grpd.__file__)
for task in sorted(EXPERTS):
    env = gym.make(task, num_envs=2, obs_mode="graph", sim_backend="cpu")
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.close()
    print(task)
"""


def run(*arguments, folder):
    """Run a program that has to succeed; return what it prints."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    result = subprocess.run(
        [str(argument) for argument in arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Build from a copy of what git tracks, so that nothing else gets in; return the wheel and the source distribution."""
    folder = tmp_path_factory.mktemp("dist")
    source = folder / "source"
    source.mkdir()
    files = run("git", "ls-files", "--cached", "--others", "--exclude-standard", "maniskill_grpd", "*.toml", "*.in", folder=ROOT)
    for name in [*files.splitlines(), "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "constraints.txt"]:
        target = source / name
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes((ROOT / name).read_bytes())
    run(sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, source, folder=folder)
    return next(folder.glob("*.whl")), next(folder.glob("*.tar.gz"))


@pytest.fixture(scope="module")
def installed(built, tmp_path_factory):
    """Return the folder of the programs of an environment that holds the wheel, and libraries of this one by a path file."""
    folder = tmp_path_factory.mktemp("environment")
    run(sys.executable, "-m", "venv", "--without-pip", folder, folder=folder)
    scheme = {"base": str(folder), "platbase": str(folder)}
    packages = Path(sysconfig.get_path("purelib", vars=scheme))
    run(sys.executable, "-m", "pip", "--python", folder, "install", "--no-deps", "--no-index", built[0], folder=folder)
    libraries = {str(Path(entry)) for entry in [*site.getsitepackages(), *sys.path] if Path(entry).name == "site-packages"}
    (packages / "libraries.pth").write_text("\n".join(sorted(libraries)) + "\n")
    return Path(sysconfig.get_path("scripts", vars=scheme))


def test_a_wheel_is_the_package_and_nothing_else(built):
    with zipfile.ZipFile(built[0]) as wheel:
        names = set(wheel.namelist())
        (metadata_file,) = [name for name in names if name.endswith(".dist-info/METADATA")]
        metadata = HeaderParser().parsestr(wheel.read(metadata_file).decode())
        (scripts,) = [wheel.read(name).decode() for name in names if name.endswith("entry_points.txt")]
    tops = {name.split("/")[0].partition("-")[0] for name in names}
    assert tops == {"maniskill_grpd"}
    assert {"maniskill_grpd/py.typed", "maniskill_grpd/viewer/replay_player.html"} <= names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert "maniskill-grpd = maniskill_grpd.commands:main" in scripts
    assert set(metadata.get_all("Provides-Extra")) == EXTRAS
    assert metadata["License-Expression"] == "Apache-2.0"
    supported = SpecifierSet(metadata["Requires-Python"])
    assert [f"3.{minor}" for minor in range(8, 16) if f"3.{minor}" in supported] == ["3.10", "3.11", "3.12"]


def test_a_source_distribution_has_no_tests(built):
    with tarfile.open(built[1]) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    assert not any(name.startswith("tests") for name in names)
    assert {"README.md", "LICENSE", "CITATION.cff", "CHANGELOG.md", "maniskill_grpd/py.typed"} <= names


def test_the_papers_of_both_are_in_order(built):
    run(sys.executable, "-m", "twine", "check", "--strict", *built, folder=ROOT)


def test_all_tasks_are_made_from_an_empty_folder(installed, tmp_path):
    place, *tasks = run(installed / "python", "-c", MAKE_ALL, folder=tmp_path).splitlines()
    assert str(installed.parent) in place
    assert tasks == ["ClothFolding-v1", "ClothHanging-v1", "RopeShaping-v1", "RopeWrapping-v1"]
    assert not any(tmp_path.iterdir())


def test_the_quick_demo_leaves_a_video_and_a_curve(installed, tmp_path):
    printed = run(installed / "maniskill-grpd", "demo", "--quick", folder=tmp_path)
    assert "after training" in printed
    names = {path.name for path in (tmp_path / "runs" / "demo").iterdir()}
    assert names >= {"learning_curve.png", "metrics.json", "final_ckpt.pt"}
    assert names & {"policy.mp4", "policy.gif"}
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]
