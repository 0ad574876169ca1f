"""Run the validation cases of the physics and write what they gave; `make docs` makes tables and plots of it.

python -m tools.docs.measure_physics

Writes docs/physics/validation.json (closed form, measurement and tolerance of every check) and strain.json beside it (strain of
cloths dragged by their corners). Takes a few minutes.
"""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from tests.physics.validation import cloth_statics, contact, rope_dynamics, rope_statics
from tests.physics.validation.corner_drag import corner_cloth, strain_percentiles
from tests.physics.validation.record import Check
from tools.docs.physics_validation import STRAINS

FOLDER = Path(__file__).parents[2] / "docs" / "physics"
MODULES = (rope_statics, rope_dynamics, cloth_statics, contact)
NUMS_NODES = (100, 225, 1225)


def run_cases() -> list[Check]:
    """Return the checks of all cases, in the order T1, T2, ..."""
    checks = []
    for module in MODULES:
        for case in module.CASES:
            checks += case.checks()
            sys.stdout.write(f"{case}\n")
    return sorted(checks, key=lambda check: int(check.test[1:]))


def measure_strain(num_nodes: int) -> dict[str, Any]:
    """Return the percentiles of the strain of a cloth dragged by its corners."""
    percentiles = strain_percentiles(num_nodes)
    substeps = corner_cloth(num_nodes).default_substeps
    return {"nodes": num_nodes, "substeps": substeps, **dict(zip(STRAINS, percentiles, strict=True))}


def write(name: str, rows: list[dict[str, Any]]) -> None:
    """Write rows to a file of docs/physics."""
    (FOLDER / name).write_text(json.dumps(rows, indent=1, default=float) + "\n", encoding="utf-8")


def main() -> None:
    """Run all cases and write."""
    torch.set_num_threads(1)
    write("validation.json", [asdict(check) | {"holds": bool(check.holds)} for check in run_cases()])
    write("strain.json", [measure_strain(num_nodes) for num_nodes in NUMS_NODES])


if __name__ == "__main__":
    main()
