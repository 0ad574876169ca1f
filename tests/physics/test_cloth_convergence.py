"""Cloth is as stiff as its material at every mesh, keeps its size at full speed, and comes to rest."""

import itertools

import pytest
import torch
from validation import cloth_convergence

from maniskill_grpd.physics import Solver


@pytest.mark.parametrize("num_nodes", [64, 225, 1225])
def test_a_cloth_hung_from_two_corners_is_stretched_by_its_weight_alone(num_nodes):
    """The material gives 0.3 to 0.7 % where the load enters; a sweep that starts anew in every substep left up to 9.7 %."""
    seconds = 10.0 if num_nodes < 1225 else 5.0
    solver = cloth_convergence.hang(cloth_convergence.square_cloth(num_nodes), 2, seconds)
    assert cloth_convergence.edge_strains(solver).max() <= 0.015


def test_more_substeps_do_not_change_how_far_a_hanging_cloth_stretches():
    few, many = (cloth_convergence.strain_at_rest(225, substeps) for substeps in (36, 108))
    assert few == pytest.approx(many, abs=0.004)


@pytest.mark.parametrize(("num_nodes", "num_worlds"), [(100, 16), (1225, 2)])
def test_no_edge_stretches_far_where_corners_are_dragged_apart(num_nodes, num_worlds):
    median, high = cloth_convergence.largest_strains(num_nodes, num_worlds)
    assert median <= 0.05
    assert high <= 0.10


def test_a_cloth_held_by_one_corner_comes_to_rest():
    """Impulses in the directions of a sweep turn it for ever, with 1.5e-5 J and 1e-4 kg m^2/s at this mesh."""
    spin, kinetic = cloth_convergence.resting_spin(100, 60.0)
    assert abs(spin) < 3e-6
    assert kinetic < 1e-6


def test_a_cloth_without_damping_loses_energy_though_not_in_every_second():
    """Nothing in the method forbids gains: up to 0.4 % of m g L came within a second, with all elastic energy counted too."""
    energies = cloth_convergence.undamped_energies(100, 20)
    unit = 0.2 * 0.4**2 * 9.81 * 0.4
    assert max(later - earlier for earlier, later in itertools.pairwise(energies)) < 5e-3 * unit
    assert all(later < earlier - 0.01 * unit for earlier, later in itertools.pairwise(energies[::5]))


def test_a_turning_cloth_in_free_flight_keeps_its_momentum_and_gains_no_energy():
    model = cloth_convergence.square_cloth(100, damping=0.0)
    solver = Solver(model, 1, 1)
    solver.plane[:, 3] = -1000.0
    solver.gravity[:] = 0.0
    solver.reset(torch.tensor([0]))
    masses = torch.as_tensor(model.masses).double()
    turn = torch.tensor([[1.0, 2.0, 3.0]]).expand(model.num_nodes, 3)
    solver.velocities[0] = torch.linalg.cross(turn, solver.positions[0])

    def measure() -> tuple[torch.Tensor, torch.Tensor, float]:
        x, v = solver.positions[0].double(), solver.velocities[0].double()
        middle = (masses[:, None] * x).sum(dim=0) / masses.sum()
        spin = (masses[:, None] * torch.linalg.cross(x - middle, v)).sum(dim=0)
        return (masses[:, None] * v).sum(dim=0), spin, 0.5 * (masses * v.square().sum(dim=-1)).sum().item()

    _, spin, energy = measure()
    for _ in range(100):
        solver.step()
    momentum, later_spin, later_energy = measure()
    assert momentum.norm() < 1e-5
    assert (later_spin - spin).norm() < 0.1 * spin.norm()
    assert later_energy < energy


def test_tension_is_part_of_the_state():
    """What is restored goes on bit for bit; without its tensions it would not."""
    solver = cloth_convergence.hang(cloth_convergence.square_cloth(64), 2, 3.0)
    state = solver.state()
    solver.step()
    expected = solver.positions.clone()
    solver.set_state(state)
    solver.step()
    assert torch.equal(solver.positions, expected)
    solver.set_state({**state, "tensions": torch.zeros_like(state["tensions"])})
    solver.step()
    assert not torch.equal(solver.positions, expected)


def test_the_strained_edges_of_a_hanging_cloth_bear_its_weight():
    """Vertical components of what the material pulls across a level line sum up to the weight below it."""
    solver = cloth_convergence.hang(cloth_convergence.square_cloth(100), 2, 15.0)
    model, x = solver.model, solver.positions[0].double()
    pairs = torch.as_tensor(model.edges).long()
    first, second = x[pairs[:, 0]], x[pairs[:, 1]]
    level = 0.5 * (x[:, 2].min() + x[:, 2].max())
    crosses = (first[:, 2] - level) * (second[:, 2] - level) < 0.0
    stretch = (first - second).norm(dim=-1) - torch.as_tensor(model.rest_lengths).double()
    force = stretch / torch.as_tensor(model.stretch_compliances).double()
    slope = (first - second)[:, 2].abs() / (first - second).norm(dim=-1)
    weight = 9.81 * torch.as_tensor(model.masses).double()[x[:, 2] < level].sum()
    assert (force * slope)[crosses].sum().item() == pytest.approx(weight.item(), rel=0.03)
