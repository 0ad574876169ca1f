"""The arrows between packages run one way; those in `FREE_OF_SIMULATOR` do not know ManiSkill."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "maniskill_grpd"

ALLOWED = {
    "physics": {"physics"},
    "rendering": {"rendering", "physics"},
    "graphs": {"graphs", "extras"},
    "policies": {"policies", "graphs"},
    "learning": {"learning", "graphs", "policies", "extras"},
    "experiments": {"experiments", "runs", "learning", "graphs", "policies", "program", "extras"},
    "agents": {"agents", "physics"},
    "viewer": {"viewer", "extras"},
    "tasks": {"tasks", "agents", "graphs", "physics", "rendering", "viewer"},
    "experts": {"experts", "tasks", "agents", "graphs", "physics"},
    "trajectory": {"trajectory", "tasks"},
    "runs": {"runs", "tasks", "viewer", "learning", "policies", "graphs", "processor"},
    "imitation": {"imitation", "runs", "experts", "tasks", "trajectory", "learning", "policies", "graphs"},
    "planning": {"planning", "runs", "tasks", "trajectory", "learning", "policies", "graphs"},
    "playing": {
        "playing",
        "planning",
        "viewer",
        "runs",
        "experts",
        "trajectory",
        "tasks",
        "agents",
        "learning",
        "policies",
        "graphs",
        "physics",
    },
    "commands": {
        "commands",
        "program",
        "extras",
        "playing",
        "planning",
        "viewer",
        "runs",
        "imitation",
        "experiments",
        "trajectory",
        "learning",
        "policies",
    },
}
SIMULATOR = {"mani_skill", "sapien", "gymnasium"}
FREE_OF_SIMULATOR = {"physics", "rendering", "graphs", "policies", "learning", "experiments", "viewer"}
FREE_OF_WARP = {"graphs", "policies", "learning", "experiments", "viewer"}


def imported_modules(path: Path, package: str) -> set[str]:
    """Return the full names of what a module in the dotted `package` imports, however it is written."""
    modules = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) + 1 - node.level] if node.level else []
            base = ".".join([*above, *([node.module] if node.module else [])])
            modules |= {base} | {f"{base}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Attribute):  # what `import maniskill_grpd` alone gives access to
            modules.add(ast.unparse(node))
    return modules


def forbidden_imports(path: Path, package: str) -> list[str]:
    """Return what a module in the dotted `package` imports against the arrows."""
    home = package.split(".")[1]
    libraries = (SIMULATOR if home in FREE_OF_SIMULATOR else set()) | ({"warp"} if home in FREE_OF_WARP else set())
    own = {entry.stem for entry in PACKAGE.iterdir()} - ALLOWED[home] - {"version"}
    names = ((module, *module.split("."), "") for module in imported_modules(path, package))
    return [module for module, root, part, *_ in names if root in libraries or (root == "maniskill_grpd" and part in own)]


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_packages_import_only_what_lies_below_them(package):
    for path in (PACKAGE / package).rglob("*.py"):
        assert not forbidden_imports(path, ".".join(path.parent.relative_to(PACKAGE.parent).parts)), path


@pytest.mark.parametrize(
    "line",
    [
        "import maniskill_grpd.learning",
        "import maniskill_grpd.learning.gae as gae",
        "from maniskill_grpd.learning import gae",
        "from maniskill_grpd import learning",
        "from maniskill_grpd import learning as other",
        "from ..learning import gae",
        "from .. import learning",
        "import maniskill_grpd\nmaniskill_grpd.learning.gae",
        "def late():\n    from .. import learning",
        "import gymnasium.spaces",
        "from gymnasium import spaces",
        "import warp as wp",
    ],
)
def test_forbidden_imports_are_seen_however_they_are_written(line, tmp_path):
    path = tmp_path / "module.py"
    path.write_text("from maniskill_grpd import graphs\nfrom ..graphs import schema\nfrom . import policy\n")
    assert forbidden_imports(path, "maniskill_grpd.policies") == []
    path.write_text(line)
    assert forbidden_imports(path, "maniskill_grpd.policies")


def test_every_package_has_its_arrows_stated():
    packages = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()}
    assert packages == set(ALLOWED)


def test_policies_and_learning_import_without_the_simulator():
    """Blocking mani_skill and sapien must not stop what has nothing to do with them."""
    program = (
        "import sys, importlib.util as u\n"
        "find = u.find_spec\n"
        "u.find_spec = lambda name, *a: None if name == 'mani_skill' else find(name, *a)\n"
        "for name in ('mani_skill', 'sapien'): sys.modules[name] = None\n"
        "import maniskill_grpd.physics, maniskill_grpd.graphs, maniskill_grpd.policies, maniskill_grpd.learning\n"
        "import maniskill_grpd.experiments.run_study, maniskill_grpd.experiments.sweep\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
