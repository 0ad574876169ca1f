"""The arrows between packages run one way; physics, graphs, policies, learning and experiments are free of the simulator."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "maniskill_grpd"

ALLOWED = {
    "physics": {"physics"},
    "graphs": {"graphs"},
    "policies": {"policies", "graphs"},
    "learning": {"learning", "graphs", "policies"},
    "experiments": {"experiments", "learning", "graphs", "policies"},
    "agents": {"agents", "physics"},
    "tasks": {"tasks", "agents", "graphs", "physics"},
    "experts": {"experts", "tasks", "agents", "graphs", "physics"},
    "trajectory": {"tasks"},
    "runs": {"runs", "tasks", "learning", "policies", "graphs", "processor"},
    "imitation": {"imitation", "runs", "experts", "trajectory", "learning", "policies", "graphs"},
    "commands": {"commands", "runs", "imitation", "experiments", "trajectory", "learning", "policies"},
}
SIMULATOR = {"mani_skill", "sapien", "gymnasium"}
FREE_OF_SIMULATOR = {"physics", "graphs", "policies", "learning", "experiments"}


def imported_modules(path: Path) -> set[str]:
    modules = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            modules.add(node.module)
    return modules


@pytest.mark.parametrize("package", sorted(ALLOWED))
def test_packages_import_only_what_lies_below_them(package):
    for path in (PACKAGE / package).rglob("*.py"):
        for module in imported_modules(path):
            parts = module.split(".")
            if parts[0] == "maniskill_grpd" and len(parts) > 1:
                assert parts[1] in ALLOWED[package] | {"version"}, f"{path} imports {module}"
            if package in FREE_OF_SIMULATOR:
                assert parts[0] not in SIMULATOR, f"{path} imports {module}"
            if package in {"policies", "learning", "graphs", "experiments"}:
                assert parts[0] != "warp", f"{path} imports {module}"


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
        "import maniskill_grpd.experiments.pages\n"
    )
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
