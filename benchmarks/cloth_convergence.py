"""Strain and spin of cloth over its resolution.

Largest strain of a cloth that hangs at rest from two corners; of one whose corners are dragged apart, per world and step; what is
left of the spin and of the kinetic energy of one that has hung from one corner for a minute (10 s from 484 nodes on).

python -m benchmarks.cloth_convergence                      # a table for docs/physics.md, some minutes
python -m benchmarks.cloth_convergence --json cloth.json    # the rows as well

The command uses nothing but the public solver, so that an older checkout can be measured by the same file:
(copied there) python -m benchmarks.cloth_convergence
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import torch
import tyro

from tests.physics.validation.cloth_convergence import RESOLUTIONS, largest_strains, resting_spin, square_cloth, strain_at_rest


@dataclass(frozen=True, kw_only=True)
class Options:
    """What is measured."""

    resolutions: tuple[int, ...] = RESOLUTIONS
    """Numbers of nodes of the square cloth of 0.4 m."""
    json: Path | None = None
    """Where the rows go."""


def measure(num_nodes: int) -> dict[str, float]:
    """Return one row."""
    median, high = largest_strains(num_nodes, 16 if num_nodes <= 484 else 4)
    spin, kinetic = resting_spin(num_nodes, 60.0 if num_nodes <= 225 else 10.0)
    return {
        "nodes": num_nodes,
        "substeps": square_cloth(num_nodes).default_substeps,
        "strain_at_rest": strain_at_rest(num_nodes),
        "largest_strain_median": median,
        "largest_strain_p99": high,
        "spin": abs(spin),
        "kinetic_energy": kinetic,
    }


def main(options: Options) -> None:
    """Print the table, row by row."""
    torch.set_num_threads(1)
    heads = ("nodes", "substeps", "at rest", "apart, median", "apart, 99th percentile", "spin [kg m^2/s]", "kinetic energy [J]")
    print("| " + " | ".join(heads) + " |")
    print("|--:|--:|--:|--:|--:|--:|--:|")
    rows = []
    for num_nodes in options.resolutions:
        row = measure(num_nodes)
        rows.append(row)
        print(
            f"| {num_nodes:,} | {row['substeps']} | {row['strain_at_rest']:.2%} | {row['largest_strain_median']:.1%} "
            f"| {row['largest_strain_p99']:.1%} | {row['spin']:.0e} | {row['kinetic_energy']:.0e} |",
            flush=True,
        )
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(tyro.cli(Options, description=__doc__))
