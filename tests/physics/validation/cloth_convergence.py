"""How cloth converges with its mesh: strain where it hangs and is dragged, spin and energy of what should rest."""

from __future__ import annotations

import torch

from maniskill_grpd.physics import ClothMaterial, Model, Solver, cloth, square_outline

from .corner_drag import ALL_CORNERS, drag

SIDE = 0.4
RESOLUTIONS = (64, 100, 225, 484, 1225)


def square_cloth(num_nodes: int, **material: float) -> Model:
    """Return a square cloth of 0.4 m, a regular grid."""
    return cloth(square_outline(SIDE), num_nodes=num_nodes, material=ClothMaterial(**material))


def hang(model: Model, num_corners: int, seconds: float, substeps: int | None = None) -> Solver:
    """Hold a flat cloth by its first corners and let it swing down."""
    solver = Solver(model, 1, num_corners, substeps=substeps)
    solver.plane[:, 3] = -10.0
    corners = torch.as_tensor(model.node_sets["corners"][:num_corners])
    solver.reset(torch.tensor([0]), gripper_nodes=corners)
    for _ in range(round(seconds / solver.control_dt)):
        solver.step()
    return solver


def edge_strains(solver: Solver) -> torch.Tensor:
    """Return the strain of all springs of the first world, (E,)."""
    model = solver.model
    first, second = torch.as_tensor(model.edges).long().unbind(1)
    lengths = (solver.positions[0, first] - solver.positions[0, second]).norm(dim=-1)
    return lengths / torch.as_tensor(model.rest_lengths) - 1.0


def strain_at_rest(num_nodes: int, substeps: int | None = None) -> float:
    """Return the largest strain of a cloth that hangs from two corners."""
    return edge_strains(hang(square_cloth(num_nodes), 2, 10.0, substeps)).max().item()


def largest_strains(num_nodes: int, num_worlds: int) -> tuple[float, float]:
    """Drag each corner its own way; return median and 99th percentile, over worlds and steps, of the largest strain."""
    largest = drag(num_nodes, num_worlds, ALL_CORNERS, apart=True).amax(dim=-1).flatten()
    return largest.median().item(), largest.quantile(0.99).item()


def spin_and_energy(solver: Solver) -> tuple[float, float, float]:
    """Return the first world's angular momentum about the vertical through its gripper [kg m^2/s], kinetic and total energy [J].

    The total is kinetic, gravitational and that of stretch; bending holds next to nothing.
    """
    model, x, v = solver.model, solver.positions[0].double(), solver.velocities[0].double()
    masses = torch.as_tensor(model.masses).double()
    spin = (masses[:, None] * torch.linalg.cross(x - solver.gripper_positions[0, 0], v)).sum(dim=0)[2]
    kinetic = 0.5 * (masses * v.square().sum(dim=-1)).sum()
    stretch = edge_strains(solver).double().clamp(min=0.0) * torch.as_tensor(model.rest_lengths)
    elastic = 0.5 * (stretch.square() / torch.as_tensor(model.stretch_compliances)).sum()
    return spin.item(), kinetic.item(), (kinetic + elastic + 9.81 * (masses * x[:, 2]).sum()).item()


def resting_spin(num_nodes: int, seconds: float = 60.0) -> tuple[float, float]:
    """Hold a cloth by one corner; return spin and kinetic energy that are left."""
    spin, kinetic, _ = spin_and_energy(hang(square_cloth(num_nodes), 1, seconds))
    return spin, kinetic


def undamped_energies(num_nodes: int, seconds: int) -> list[float]:
    """Hold a cloth without damping by one corner; return its total energy [J] after every second."""
    solver = hang(square_cloth(num_nodes, damping=0.0), 1, 0.0)
    energies = [spin_and_energy(solver)[2]]
    for _ in range(seconds):
        for _ in range(round(1.0 / solver.control_dt)):
            solver.step()
        energies.append(spin_and_energy(solver)[2])
    return energies
