"""T1 to T4, T6, T7: ropes at rest."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from maniskill_grpd.physics import RopeMaterial, Solver, rope

from . import closed_forms
from .closed_forms import FLOAT32_ULP, GRAVITY
from .record import Case, Check


def float_strain(dt: float, length: float, stiffness_acceleration: float = GRAVITY) -> float:
    """Return the relative error of a weight: positions of size `length` round by half an ulp against the fall g dt^2."""
    return 0.5 * FLOAT32_ULP * length / (stiffness_acceleration * dt**2)


def free_solver(model, **options) -> Solver:
    """Return one world far above its table."""
    solver = Solver(model, 1, 2, **options)
    solver.plane[:, 3] = -100.0
    return solver


def settle(solver: Solver, seconds: float) -> None:
    """Let the damped world come to rest."""
    for _ in range(round(seconds / solver.control_dt)):
        solver.step()


def hanging_rod(test: str, *, num_nodes: int, substeps: int) -> Iterator[Check]:
    """Delta L = rho g L^2 / (2 EA) for a rod hung by its end; exact at every resolution with half masses at the ends."""
    density, stiffness, length = 0.05, 20.0, 1.0
    material = RopeMaterial(linear_density=density, stretch_stiffness=stiffness, bend_stiffness=0.0, damping=8.0)
    solver = free_solver(rope([[0, 0, 0], [0, 0, -length]], num_nodes=num_nodes, material=material), substeps=substeps)
    solver.inverse_masses[:, 0] = 0.0
    settle(solver, 5.0)
    expected = density * GRAVITY * length**2 / (2.0 * stiffness)
    dt = solver.control_dt / substeps
    yield Check(
        test=test,
        what=f"elongation of a hanging rod, {num_nodes} nodes, {substeps} substeps [m]",
        equation="rho g L^2 / (2 EA)",
        expected=expected,
        measured=-solver.positions[0, -1, 2].item() - length,
        tolerance=num_nodes * FLOAT32_ULP * length + 2.0 * float_strain(dt, length) * expected,
        why="one rounding per node; weight rounds to ulp/2 against g dt^2, twice (position and velocity)",
    )


def tip_load(test: str) -> Iterator[Check]:
    """Delta L = F L / EA, the load being a heavy node at the end of a nearly massless rope."""
    stiffness, load, density = 20.0, 0.02, 1e-4
    material = RopeMaterial(linear_density=density, stretch_stiffness=stiffness, bend_stiffness=0.0, damping=8.0)
    solver = free_solver(rope([[0, 0, 0], [0, 0, -1]], num_nodes=11, material=material))
    solver.inverse_masses[:, 0] = 0.0
    solver.inverse_masses[:, -1] = 1.0 / load
    settle(solver, 10.0)
    expected = (load + 0.5 * density) * GRAVITY / stiffness
    dt = solver.control_dt / solver.substeps[0]
    yield Check(
        test=test,
        what="elongation under a tip load [m]",
        equation="F L / EA",
        expected=expected,
        measured=-solver.positions[0, -1, 2].item() - 1.0,
        tolerance=11 * FLOAT32_ULP + 2.0 * float_strain(dt, 1.0) * expected,
        why="as for the hanging rod",
    )


def iteration_independence(test: str, *, bend_stiffness: float) -> Iterator[Check]:
    """A compliance is a material constant: the same equilibrium for dt, dt / 2 and dt / 4 (Macklin et al. 2016).

    Reference is the run with the smallest substep, since for a rope that both bends and stretches there is no closed form.
    """
    length, density = 0.5, 0.05
    material = RopeMaterial(linear_density=density, stretch_stiffness=50.0, bend_stiffness=bend_stiffness, damping=6.0)
    sags = {}
    for substeps in (5, 10, 20):
        model = rope([[0, 0, 0], [length, 0, 0]], num_nodes=11, material=material)
        solver = free_solver(model, substeps=substeps)
        solver.reset(torch.tensor([0]), solver.positions * torch.tensor([0.8, 1.0, 1.0]), torch.tensor([0, 10]))
        settle(solver, 8.0)
        sags[substeps] = -solver.positions[0, :, 2].min().item()
    segment = length / 10
    longer, same = (closed_forms.catenary(factor * length, 0.8 * length)[0] for factor in (1.001, 1.0))
    sensitivity = (longer - same) / (0.001 * length)
    for substeps in (5, 10):
        dt = 0.05 / substeps
        softening = closed_forms.bend_softening(bend_stiffness, density, segment, dt)
        newton_strain = 2.0 * (GRAVITY * dt**2 / segment) ** 2
        yield Check(
            test=test,
            what=f"sag of a held rope, {substeps} substeps, EI = {bend_stiffness:g} N m^2 [m]",
            equation="sag at 20 substeps",
            expected=sags[20],
            measured=sags[substeps],
            tolerance=sags[20] * (softening + float_strain(0.05 / 20, length)) + sensitivity * length * newton_strain,
            why="softening 3 EI dt^2/(rho l^4) of the bending sweep; strain (2 g dt^2)^2/(2 l^2) of one Newton step; roundings",
        )


def hanging_chain(test: str, *, slack: float, num_links: int) -> Iterator[Check]:
    """An inextensible chain of length L over a span d: L = 2 a sinh(d / 2a), sag = a (cosh(d / 2a) - 1)."""
    span, length = 0.5, 0.5 * slack
    material = RopeMaterial(stretch_stiffness=5e3, bend_stiffness=0.0, damping=4.0)
    depth = 0.5 * np.sqrt(length**2 - span**2)
    model = rope([[0, 0, 0], [span / 2, 0, -depth], [span, 0, 0]], num_nodes=num_links + 1, material=material)
    sag, a = closed_forms.catenary(length, span)
    solver = free_solver(model)
    solver.reset(torch.tensor([0]), torch.as_tensor(model.rest_positions)[None], torch.tensor([0, num_links]))
    settle(solver, 10.0)
    discrete = closed_forms.discrete_catenary_sag(length, span, num_links)
    # Stretch lengthens the chain by at most the strain of its largest tension; d(sag)/dL by a difference of the closed form.
    weight = material.linear_density * GRAVITY
    strain = weight * (a + sag) / material.stretch_stiffness
    sensitivity = (closed_forms.catenary(length * 1.001, span)[0] - sag) / (0.001 * length)
    dt = solver.control_dt / solver.substeps[0]
    noise = num_links * FLOAT32_ULP * span * sensitivity + float_strain(dt, span) * sag
    yield Check(
        test=test,
        what=f"sag of a chain, L/d = {slack:g}, {num_links} links [m]",
        equation="a (cosh(d / 2a) - 1)",
        expected=sag,
        measured=-solver.positions[0, :, 2].min().item(),
        tolerance=abs(discrete - sag) + strain * length * sensitivity + noise + drift_bound(solver),
        why="sag of the exact chain of rigid links; elastic strain; roundings; what is left of the motion",
    )


def drift_bound(solver: Solver) -> float:
    """Return how far [m] the slowest node still moves while its velocity decays with the damping of the material."""
    return solver.velocities.norm(dim=-1).max().item() / solver.model.damping


def cantilever(test: str, *, gamma: float, length: float, num_nodes: int = 12) -> Iterator[Check]:
    """Heavy elastica: B theta'' = -w (L - s) cos(theta); one parameter, Gamma = w L^3 / B (master curve).

    Two fixed nodes clamp the rope. Hinge k stands for the bend within half a segment to either side, so the clamp of the
    continuous beam lies half a segment behind the first hinge: L = (N - 3/2) l.
    """
    density = 0.05
    segment = length / (num_nodes - 1.5)
    weight = density * GRAVITY
    stiffness = weight * length**3 / gamma
    material = RopeMaterial(
        linear_density=density, stretch_stiffness=2e3 * weight * length, bend_stiffness=stiffness, damping=4.0 / np.sqrt(length)
    )
    model = rope([[0, 0, 0], [segment * (num_nodes - 1), 0, 0]], num_nodes=num_nodes, material=material)
    substeps = balanced_substeps(gamma, length, num_nodes)
    solver = free_solver(model, substeps=substeps)
    solver.inverse_masses[:, :2] = 0.0
    settle(solver, 8.0 * np.sqrt(length))
    reach, drop = closed_forms.heavy_elastica(gamma)
    dt = solver.control_dt / substeps
    softer = closed_forms.heavy_elastica(gamma * (1.0 + 1e-3))
    softening = closed_forms.bend_softening(stiffness, density, segment, dt) + 2.0 * float_strain(dt, length)
    where = f"Gamma = {gamma:g}, L = {length:g} m, {num_nodes} nodes, {substeps} substeps"
    for name, measured, expected, slope in (
        ("drop/L", -solver.positions[0, -1, 2].item() / length, drop, (softer[1] - drop) / 1e-3),
        ("X/L", (solver.positions[0, -1, 0].item() - 0.5 * segment) / length, reach, (softer[0] - reach) / 1e-3),
    ):
        # Midpoint rule of the moment: the half segment behind the first hinge carries no weight of its own, and hinges lump
        # curvature, both of relative order (l / L)^2; hinges saturate by kappa^2 l^2 / 24 < Gamma^2 (l / L)^2 / 96 at the root.
        lumping = (segment / length) ** 2 * (1.0 + min(gamma, 8.0) ** 2 / 96.0) * max(expected, 0.2)
        yield Check(
            test=test,
            what=f"{name} of a cantilever, {where}",
            equation="heavy elastica",
            expected=expected,
            measured=measured,
            tolerance=lumping + abs(slope) * softening + 5e-4 + drift_bound(solver) / length,
            why="(l/L)^2 of the hinges; softening 3 EI dt^2/(rho l^4) of the sweep; strain w L/EA = 5e-4; roundings",
        )


def balanced_substeps(gamma: float, length: float, num_nodes: int) -> int:
    """Return the substeps per 0.05 s at which the softening of the sweep, ~dt^2, equals the rounding of weight, ~1 / dt^2."""
    ratio = np.sqrt(FLOAT32_ULP * gamma / (3.0 * (num_nodes - 1.5) ** 4))  # g dt^2 / L
    return round(0.05 / np.sqrt(ratio * length / GRAVITY))


def ring(test: str) -> Iterator[Check]:
    """A straight rope whose clamped ends meet rests as a circle: kappa = 2 pi / L everywhere, held by M = 2 pi EI / L.

    The regular polygon is also the exact equilibrium of the discrete rope; it is started with bumps, without gravity.
    """
    num_nodes, length = 41, 0.8
    material = RopeMaterial(stretch_stiffness=2e3, bend_stiffness=2e-5, damping=1.0)
    model = rope([[0, 0, 0], [length, 0, 0]], num_nodes=num_nodes, material=material)
    solver = free_solver(model, substeps=40)
    solver.gravity.zero_()
    segment = length / (num_nodes - 1)
    radius = 0.5 * segment / np.sin(np.pi / (num_nodes - 1))
    angles = 2.0 * np.pi * (np.arange(num_nodes) + 0.5) / (num_nodes - 1)
    circle = radius * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    bump = 0.02 * radius * np.sin(np.pi * np.linspace(0.0, 1.0, num_nodes)) ** 2 * np.sin(3.0 * angles)
    start = circle * (1.0 + bump / radius)[:, None]
    clamped = [0, 1, num_nodes - 2, num_nodes - 1]
    start[clamped] = circle[clamped]
    solver.reset(torch.tensor([0]), torch.as_tensor(start, dtype=torch.float32)[None])
    solver.inverse_masses[:, clamped] = 0.0
    settle(solver, 60.0)
    points = solver.positions[0].double().numpy()
    steps = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1, keepdims=True)
    turns = np.degrees(np.arccos(np.clip((steps[1:] * steps[:-1]).sum(axis=1), -1.0, 1.0)))
    strain = 2.0 * material.bend_stiffness * (2.0 * np.pi / length) ** 2 / material.stretch_stiffness
    dt = solver.control_dt / solver.substeps[0]
    softening = closed_forms.bend_softening(material.bend_stiffness, material.linear_density, segment, dt)
    tolerance = np.degrees(4.0 * FLOAT32_ULP * radius / segment) + 360.0 * strain + np.degrees(drift_bound(solver) / radius)
    tolerance += 9.0 * softening
    yield Check(
        test=test,
        what="RMS deviation of the turning angle of a ring from 9 deg [deg]",
        equation="theta = 2 pi l / L",
        expected=0.0,
        measured=float(np.sqrt(np.mean((turns - 9.0) ** 2))),
        tolerance=tolerance,
        why="softening of the sweep, which differs by colour; roundings over a segment; strain; what is left of the motion",
    )
    yield Check(
        test=test,
        what="largest distance of the ring from its circle [m]",
        equation="|x| = R",
        expected=0.0,
        measured=float(np.abs(np.linalg.norm(points, axis=1) - radius).max()),
        tolerance=radius * np.radians(tolerance),
        why="the same angle times the radius",
    )


def bend_stiffness_scaling(test: str) -> Iterator[Check]:
    """Small deflection: drop = w L^4 / (8 EI), so drop times EI is constant over EI, 3 EI, 9 EI; nothing leaks sideways.

    Newton's own test of the same law asks for 10 %.
    """
    length, num_nodes, density = 0.5, 7, 0.05
    segment = length / (num_nodes - 1.5)
    for gamma in (1.0, 1.0 / 3.0, 1.0 / 9.0):
        stiffness = density * GRAVITY * length**3 / gamma
        material = RopeMaterial(linear_density=density, stretch_stiffness=500.0, bend_stiffness=stiffness, damping=6.0)
        model = rope([[0, 0, 0], [segment * (num_nodes - 1), 0, 0]], num_nodes=num_nodes, material=material)
        solver = free_solver(model, substeps=balanced_substeps(gamma, length, num_nodes))
        solver.inverse_masses[:, :2] = 0.0
        settle(solver, 6.0)
        dt = solver.control_dt / solver.substeps[0]
        softening = closed_forms.bend_softening(stiffness, density, segment, dt)
        expected = density * GRAVITY * length**4 / 8.0
        tip = solver.positions[0, -1]
        yield Check(
            test=test,
            what=f"drop times EI, EI = {stiffness:.3g} N m^2 [N m^3]",
            equation="w L^4 / 8",
            expected=expected,
            measured=-tip[2].item() * stiffness,
            tolerance=expected * ((segment / length) ** 2 + softening + gamma**2 / 80 + float_strain(dt, length)),
            why="(l/L)^2 of the hinges; softening of the sweep; nonlinearity (1.2 % at Gamma = 1); roundings",
        )
        yield Check(
            test=test,
            what=f"sideways motion of the tip, EI = {stiffness:.3g} N m^2 [m]",
            equation="0 by symmetry",
            expected=0.0,
            measured=tip[1].abs().item(),
            tolerance=0.0,
            why="exact: no force has a component there",
        )


CASES = [
    *[Case(test="T1", run=hanging_rod, options={"num_nodes": n, "substeps": s}) for n in (6, 11, 21, 41, 81) for s in (10, 20)],
    Case(test="T1", run=tip_load),
    *[Case(test="T2", run=iteration_independence, options={"bend_stiffness": value}) for value in (0.0, 1e-6, 1e-5)],
    *[
        Case(test="T3", run=hanging_chain, options={"slack": slack, "num_links": links})
        for slack in (1.05, 1.5, 2.0)
        for links in (10, 20, 80)
    ],
    *[
        Case(test="T4", run=cantilever, options={"gamma": gamma, "length": length})
        for gamma in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
        for length in (0.5, 2.0)
    ],
    Case(test="T6", run=ring),
    Case(test="T7", run=bend_stiffness_scaling),
]
