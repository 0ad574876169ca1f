"""A square cloth dragged by its corners at full speed: how far its edges stretch."""

from __future__ import annotations

import numpy as np
import torch

from maniskill_grpd.physics import ClothMaterial, Model, Solver, cloth, square_outline

MAX_STEP = 0.03
ALL_CORNERS = [0, 1, 2, 3]


def corner_cloth(num_nodes: int, **material) -> Model:
    """Return a square cloth of 0.4 m."""
    return cloth(square_outline(0.4), num_nodes=num_nodes, material=ClothMaterial(**material))


def drag(
    num_nodes: int, num_worlds: int, gripped: list[int], num_steps: int = 40, *, apart: bool = False, **material
) -> torch.Tensor:
    """Drag a held cloth to and fro at full speed, its grippers together or each its own way.

    Returns:
        Strain of its edges, (T, B, E).
    """
    model = corner_cloth(num_nodes, **material)
    solver = Solver(model, num_worlds, len(gripped))
    solver.plane[:, 3] = -100.0
    solver.reset(torch.arange(num_worlds), gripper_nodes=torch.as_tensor(model.node_sets["corners"][gripped]))
    edges = torch.as_tensor(model.mesh_edges).long()
    rest = (solver.positions[0, edges[:, 0]] - solver.positions[0, edges[:, 1]]).norm(dim=-1)
    generator = torch.Generator().manual_seed(0)
    strains = []
    for step in range(num_steps):
        if step % 10 == 0:
            direction = torch.randn(num_worlds, len(gripped) if apart else 1, 3, generator=generator)
            move = MAX_STEP * direction / direction.norm(dim=-1, keepdim=True)
        solver.gripper_targets.copy_(solver.gripper_positions + move)
        solver.step()
        lengths = (solver.positions[:, edges[:, 0]] - solver.positions[:, edges[:, 1]]).norm(dim=-1)
        strains.append(lengths / rest - 1.0)
    assert not solver.frozen.any()
    return torch.stack(strains)


def strain_percentiles(num_nodes: int, num_worlds: int = 16) -> list[float]:
    """Return the 99th percentile of the strain with corners that go together, apart, and apart without wrinkling.

    Then the 1st percentile with corners that go apart: the compression where the cloth wrinkles.
    """
    together = drag(num_nodes, num_worlds, ALL_CORNERS).numpy()
    apart = drag(num_nodes, num_worlds, ALL_CORNERS, apart=True).numpy()
    locked = drag(num_nodes, num_worlds, ALL_CORNERS, apart=True, wrinkle_strain=np.inf).numpy()
    return [float(np.quantile(strain, 0.99)) for strain in (together, apart, locked)] + [float(np.quantile(apart, 0.01))]
