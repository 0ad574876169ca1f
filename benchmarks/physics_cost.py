"""Bytes and operations of a control step of one world, counted from the constraints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maniskill_grpd.physics import Model

FLOAT, VECTOR = 4, 12
# One spring: position (read, write), inverse mass and holder of two nodes; rest length, compliance, two indices. Operations of
# difference, length, division by the sum of weights, and two updates.
SPRING = {"bytes": 4 * VECTOR + 4 * FLOAT + 4 * FLOAT, "flops": 38}
# One hinge: four nodes likewise, four weights, compliance, four indices.
HINGE = {"bytes": 8 * VECTOR + 8 * FLOAT + 9 * FLOAT, "flops": 70}
BEND = {"bytes": 6 * VECTOR + 6 * FLOAT + 4 * FLOAT, "flops": 40}
# One node: predict (position, velocity, previous, gravity) and the contact with the table, then the velocity.
NODE = {"bytes": 8 * VECTOR + 4 * FLOAT, "flops": 45}


@dataclass(frozen=True)
class Work:
    """What a control step of one world does."""

    projections: int
    """Constraint projections (VBD: visits of an element by one of its nodes)."""
    flops: int
    bytes: int
    state: int
    """Bytes of state of one world that a substep touches."""
    constants: int
    """Bytes of constraints, which all worlds share."""


def count_work(model: Model, solver: str, substeps: int, iterations: int) -> Work:
    """Count the work of one control step; contacts of Newton and tethers of ours are left out."""
    springs, hinges, bends = len(model.edges), len(model.hinges), len(model.bends)
    if "Newton" in solver and len(model.faces):  # a hinge at every inner edge: all edges have two sides but those of the boundary
        edges = np.sort(model.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        hinges, bends = len(edges) - len(np.unique(edges, axis=0)), 0
    if "springs only" in solver:
        hinges = bends = 0
    visits = substeps * iterations
    elements = springs + hinges + bends
    projections = visits * (2 * springs + 4 * hinges + 2 * bends if "VBD" in solver else elements)
    flops, moved = (
        visits * (springs * SPRING[key] + hinges * HINGE[key] + bends * BEND[key]) + substeps * model.num_nodes * NODE[key]
        for key in ("flops", "bytes")
    )
    state = model.num_nodes * (4 * VECTOR + 2 * FLOAT)
    constants = springs * 4 * FLOAT + hinges * 9 * FLOAT + bends * 4 * FLOAT
    return Work(projections=projections, flops=flops, bytes=moved, state=state, constants=constants)
