"""Three real wires that hang between two clamps, beside the same wires simulated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from maniskill_grpd.physics import RopeMaterial, Solver, rope

DATA = Path(__file__).parent / "real_wires.json"
SUBSTEPS = 100
"""Bending acts softer by 3 EI dt^2 / (rho l^4), 4 % for the stiffest wire."""


def wire_errors(bend_factor: float = 1.0, num_steps: int = 80) -> dict[str, np.ndarray]:
    """Let wires hang with the stiffness that was measured for them, times a factor.

    A wire has one node at each point of its shape, and one more within each clamp, so that its ends are horizontal.

    Returns:
        For each wire the mean distance of its nodes from where they were seen over its length, for each of its shapes.
    """
    wires = json.loads(DATA.read_text())["wires"]
    shapes = np.array([shape for wire in wires.values() for shape in wire["shapes"]])  # (W, P, 2), y down
    segment = np.linalg.norm(np.diff(shapes, axis=1), axis=-1).mean(axis=1)[:, None]
    inside = np.concatenate([segment, np.zeros_like(segment)], axis=1)[:, None]
    points = np.concatenate([shapes[:, :1] - inside, shapes, shapes[:, -1:] + inside], axis=1)
    positions = torch.zeros(*points.shape[:2], 3)
    positions[..., 0], positions[..., 2] = torch.as_tensor(points[..., 0]), torch.as_tensor(-points[..., 1])

    material = RopeMaterial(linear_density=0.02, stretch_stiffness=1e5, bend_stiffness=1e-3, damping=3.0)
    length = float(segment.mean()) * (points.shape[1] - 1)
    solver = Solver(
        rope([[0.0, 0.0], [length, 0.0]], num_nodes=points.shape[1], material=material), len(points), 4, substeps=SUBSTEPS
    )
    solver.plane[:, 3] = -10.0
    worlds, repeats = torch.arange(len(points)), len(points) // len(wires)
    densities = torch.tensor([wire["density"] for wire in wires.values()]).repeat_interleave(repeats)
    stiffnesses = torch.tensor([value for wire in wires.values() for value in wire["stiffness"]])
    solver.set_material(
        worlds, mass=densities / material.linear_density, bend=bend_factor * stiffnesses / material.bend_stiffness
    )
    last = points.shape[1] - 1
    solver.reset(worlds, positions, torch.tensor([0, 1, last - 1, last]))
    for _ in range(num_steps):
        solver.step()
    distances = (solver.positions - positions)[:, 1:-1].norm(dim=-1).mean(dim=1).numpy()
    return dict(zip(wires, (distances / length).reshape(len(wires), repeats), strict=True))
