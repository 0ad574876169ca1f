"""Ropes against closed forms. Tolerances follow from the substep, the resolution and float32, not from what passes."""

import numpy as np
import pytest
import torch
from scipy.optimize import brentq

from maniskill_grpd.physics import RopeMaterial, Solver, rope

GRAVITY = 9.81
FLOAT32_ULP = 2.0**-23


def vertical_rope(num_nodes: int, material: RopeMaterial, length: float = 1.0):
    return rope([[0.0, 0.0, 0.0], [0.0, 0.0, -length]], num_nodes=num_nodes, material=material)


def solver_far_above_table(model, **options) -> Solver:
    solver = Solver(model, 1, 2, **options)
    solver.plane[:, 3] = -100.0
    return solver


def test_free_fall_matches_the_discrete_closed_form():
    """Symplectic Euler falls by g dt^2 n (n + 1) / 2 after n substeps; bending and stretch do not disturb it."""
    model = rope([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]], num_nodes=21, material=RopeMaterial(damping=0.0))
    solver = solver_far_above_table(model)
    for _ in range(10):
        solver.step()
    n, dt = 10 * solver.substeps, solver.control_dt / solver.substeps
    expected = -0.5 * GRAVITY * dt**2 * n * (n + 1)
    # Velocities are position differences: each substep adds one rounding at the height fallen, which the remaining steps carry on.
    tolerance = abs(expected) * FLOAT32_ULP * n**1.5
    torch.testing.assert_close(solver.positions[0, :, 2], torch.full((21,), expected), rtol=0.0, atol=tolerance)
    torch.testing.assert_close(solver.positions[0, :, 0], torch.linspace(0.0, 0.5, 21), rtol=0.0, atol=tolerance)


@pytest.mark.parametrize("num_nodes", [6, 11, 21, 41, 81])
@pytest.mark.parametrize("substeps", [10, 20])
def test_stretch_under_own_weight_does_not_depend_on_resolution_or_substeps(num_nodes, substeps):
    """A hanging rod grows by rho g L^2 / (2 EA); with half masses at the ends the discrete chain does so exactly."""
    density, stiffness = 0.05, 20.0
    material = RopeMaterial(linear_density=density, stretch_stiffness=stiffness, bend_stiffness=0.0, damping=8.0)
    solver = solver_far_above_table(vertical_rope(num_nodes, material), substeps=substeps)
    solver.inverse_masses[:, 0] = 0.0
    for _ in range(100):
        solver.step()
    elongation = -solver.positions[0, -1, 2].item() - 1.0
    expected = density * GRAVITY / (2.0 * stiffness)
    # Rest lengths and positions round to one float32 step each; N segments add up.
    assert elongation == pytest.approx(expected, rel=2e-3, abs=num_nodes * FLOAT32_ULP)


def test_tip_load_stretches_by_force_over_stiffness():
    """Delta L = F L / EA, with the load as a heavy end node of a nearly massless rope."""
    stiffness, load = 20.0, 0.02
    material = RopeMaterial(linear_density=1e-4, stretch_stiffness=stiffness, bend_stiffness=0.0, damping=8.0)
    solver = solver_far_above_table(vertical_rope(11, material))
    solver.inverse_masses[:, 0] = 0.0
    solver.inverse_masses[:, -1] = 1.0 / load
    for _ in range(200):
        solver.step()
    expected = (load + 0.5e-4) * GRAVITY / stiffness
    assert -solver.positions[0, -1, 2].item() - 1.0 == pytest.approx(expected, rel=5e-3)


def catenary_sag(length: float, span: float) -> float:
    a = brentq(lambda a: 2.0 * a * np.sinh(span / (2.0 * a)) - length, 1e-2 * span, 1e2 * span)
    return a * (np.cosh(span / (2.0 * a)) - 1.0)


@pytest.mark.parametrize("slack", [1.05, 1.5, 2.0])
def test_hanging_chain_is_a_catenary(slack):
    """An inextensible chain of length L over a span d sags by a (cosh(d / 2a) - 1), 2 a sinh(d / 2a) = L."""
    span, num_nodes = 0.5, 61
    material = RopeMaterial(stretch_stiffness=5e3, bend_stiffness=0.0, damping=4.0)
    depth = np.sqrt((slack * span / 2.0) ** 2 - (span / 2.0) ** 2)
    v_shape = [[0.0, 0.0, 0.0], [span / 2.0, 0.0, -depth], [span, 0.0, 0.0]]
    solver = solver_far_above_table(rope(v_shape, num_nodes=num_nodes, material=material))
    solver.reset(torch.tensor([0]), torch.as_tensor(solver.model.rest_positions)[None], torch.tensor([0, num_nodes - 1]))
    for _ in range(200):
        solver.step()
    sag = -solver.positions[0, :, 2].min().item()
    # The exact discrete chain of n links sags by O(1/n^2) more: 0.7 % at 10 links and L/d = 1.5, hence 25/n^2 as a generous bound;
    # elasticity adds the strain w L / EA, which a shallow chain turns into sag times d/sag.
    discretisation = 1.0 / (num_nodes - 1) ** 2
    elasticity = material.linear_density * GRAVITY * slack * span / material.stretch_stiffness / (sag / span) ** 2
    assert sag == pytest.approx(catenary_sag(slack * span, span), rel=discretisation + elasticity + 2e-3)


@pytest.mark.parametrize("friction", [0.3, 0.6])
@pytest.mark.parametrize("margin", [-0.06, 0.06])
def test_rope_on_an_incline_sticks_below_the_friction_angle_and_slides_above(friction, margin):
    """Coulomb: a body rests while tan(slope) <= mu, else it slides with g (sin - mu cos)."""
    slope = np.arctan(friction) + margin
    material = RopeMaterial(friction=friction, damping=0.0)
    model = rope([[0.0, -0.2, 0.0], [0.0, 0.2, 0.0]], num_nodes=21, radius=0.01, material=material)
    solver = Solver(model, 1, 2)
    solver.gravity[0] = GRAVITY * torch.tensor([np.sin(slope), 0.0, -np.cos(slope)])
    solver.positions[..., 2] = 0.01
    for _ in range(10):
        solver.step()
    time, travelled = 10 * solver.control_dt, solver.positions[0, :, 0].mean().item()
    acceleration = max(0.0, GRAVITY * (np.sin(slope) - friction * np.cos(slope)))
    # First-order integration is off by g t dt / 2; sticking leaves at most float32 creep of one ulp per substep.
    dt = solver.control_dt / solver.substeps
    tolerance = 0.5 * GRAVITY * time * dt * np.sin(slope) if acceleration else 200 * FLOAT32_ULP * 0.01
    assert travelled == pytest.approx(0.5 * acceleration * time**2, abs=tolerance)


def test_the_table_holds_the_rope():
    """A dropped rope comes to rest at its radius above the table."""
    model = rope([[0.0, 0.0, 0.2], [0.4, 0.0, 0.3]], num_nodes=21)
    solver = Solver(model, 1, 2)
    for _ in range(60):
        solver.step()
        assert solver.positions[..., 2].min() >= model.radius - 1e-6
    # At rest a node dips by one substep of gravity before it is pushed out.
    assert solver.positions[..., 2].max() <= model.radius + 1e-3
    assert solver.velocities.abs().max() < 1e-2
