"""Ropes of any stiffness, mass and substep, pulled straight: how much their edges stretch."""

from __future__ import annotations

import itertools

import numpy as np
import torch

from maniskill_grpd.physics import RopeMaterial, Solver, rope

STIFFNESSES = tuple(10.0**exponent for exponent in range(2, 9))
"""Axial stiffnesses EA [N]."""
DENSITIES = (1e-4, 1e-2, 0.05, 1.0)
"""Masses per length [kg/m]."""
SUBSTEPS = (10, 20, 50, 250)
"""Substeps of a control step of 0.05 s: 5 to 0.2 ms."""
LENGTH, NUM_NODES = 0.8, 41
AMPLITUDE = 0.02
"""How far both ends are led to and fro [m], at up to 0.4 m/s."""


def largest_strains(substeps: int, num_steps: int = 60) -> np.ndarray:
    """Hold ropes at exactly their length by both ends and move the ends together.

    Returns:
        Largest strain of an edge in all steps, (densities, stiffnesses); infinity where a world was frozen.
    """
    materials = torch.tensor(list(itertools.product(DENSITIES, STIFFNESSES)))
    default, worlds = RopeMaterial(), torch.arange(len(materials))
    model = rope([[-LENGTH / 2, 0.0], [LENGTH / 2, 0.0]], num_nodes=NUM_NODES)
    solver = Solver(model, len(worlds), 2, substeps=substeps)
    solver.plane[:, 3] = -1.0
    solver.set_material(
        worlds, stretch=materials[:, 1] / default.stretch_stiffness, mass=materials[:, 0] / default.linear_density
    )
    solver.reset(worlds, gripper_nodes=torch.tensor([0, NUM_NODES - 1]))
    starts, rest_lengths = solver.gripper_positions.clone(), torch.as_tensor(model.rest_lengths)
    largest = torch.zeros(len(worlds))
    for step in range(num_steps):
        way = torch.tensor([np.sin(0.5 * step), np.cos(0.7 * step), np.sin(0.3 * step)], dtype=torch.float32)
        solver.gripper_targets.copy_(starts + AMPLITUDE * way)
        solver.step()
        lengths = solver.positions.diff(dim=1).norm(dim=-1)
        largest = torch.maximum(largest, (lengths / rest_lengths - 1.0).amax(dim=1))
    largest[solver.frozen] = torch.inf
    return largest.numpy().reshape(len(DENSITIES), len(STIFFNESSES))
