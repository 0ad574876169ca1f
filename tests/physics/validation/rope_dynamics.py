"""T10: free fall, momentum, pendulum, modes of a heavy rope, energy."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch
from scipy.special import j0

from maniskill_grpd.physics import RopeMaterial, Solver, rope

from . import closed_forms
from .closed_forms import FLOAT32_ULP, GRAVITY
from .record import Case, Check
from .rope_statics import float_strain, free_solver


def free_fall(test: str) -> Iterator[Check]:
    """Symplectic Euler falls by g dt^2 n (n + 1) / 2 after n substeps, that is g t^2 / 2 + g t dt / 2."""
    model = rope([[0, 0, 0], [0.5, 0, 0]], num_nodes=21, material=RopeMaterial(damping=0.0))
    solver = free_solver(model)
    for _ in range(10):
        solver.step()
    n, dt = 10 * solver.substeps[0], solver.control_dt / solver.substeps[0]
    drop = -solver.positions[0, :, 2].double()
    expected = 0.5 * GRAVITY * dt**2 * n * (n + 1)
    rounding = expected * FLOAT32_ULP * n**1.5
    for name, measured in (("highest", drop.min()), ("lowest", drop.max())):
        yield Check(
            test=test,
            what=f"fall of the {name} node after 0.5 s [m]",
            equation="g dt^2 n (n + 1) / 2",
            expected=expected,
            measured=measured.item(),
            tolerance=rounding,
            why="each substep rounds, the rest of the fall carries it on",
        )
    yield Check(
        test=test,
        what="fall of the centre of mass after 0.5 s against the continuous form [m]",
        equation="g t^2 / 2",
        expected=0.5 * GRAVITY * 0.25,
        measured=drop.mean().item(),
        tolerance=0.5 * GRAVITY * 0.5 * dt + rounding,
        why="first order: g t dt / 2",
    )


def energy(solver: Solver) -> tuple[float, float]:
    """Return the sum of kinetic, stretch and bending energy [J] of world 0, and the bending part."""
    model = solver.model
    masses = 1.0 / solver.inverse_masses[0].double()
    x, v = solver.positions[0].double(), solver.velocities[0].double()
    i, j = (torch.as_tensor(side, dtype=torch.long) for side in model.edges.T)
    strains = (x[i] - x[j]).norm(dim=-1) - torch.as_tensor(model.rest_lengths)
    stretch = 0.5 * (strains**2 / torch.as_tensor(model.stretch_compliances)).sum()
    p, m, n = (torch.as_tensor(side, dtype=torch.long) for side in model.bends.T)
    bend = 0.5 * ((x[p] - 2.0 * x[m] + x[n]).square().sum(-1) / torch.as_tensor(model.bend_compliances)).sum()
    return (0.5 * (masses[:, None] * v**2).sum() + stretch + bend).item(), bend.item()


def wiggling_rope() -> Solver:
    """Return a spinning, wiggling rope in free flight, without gravity, contact and damping."""
    arc = np.linspace(0.0, 1.0, 200)
    curve = np.stack([0.4 * arc, 0.05 * np.sin(9.0 * arc), 0.05 * np.cos(7.0 * arc)], axis=1)
    solver = free_solver(rope(curve, num_nodes=31, material=RopeMaterial(damping=0.0)))
    solver.gravity.zero_()
    solver.positions -= solver.positions.mean(dim=1, keepdim=True)
    spin = torch.tensor([0.0, 1.0, 4.0])
    solver.velocities.copy_(torch.linalg.cross(spin.expand_as(solver.positions), solver.positions))
    solver.velocities += 0.3 * torch.randn(solver.velocities.shape, generator=torch.Generator().manual_seed(0))
    return solver


def free_flight(test: str) -> Iterator[Check]:
    """Corrections of a constraint sum to zero when weighted by the masses: p is constant; energy only falls."""
    solver = wiggling_rope()
    masses = 1.0 / solver.inverse_masses[0, :, None].double()
    momentum = (masses * solver.velocities[0]).sum(0)
    energies = [energy(solver)]
    for _ in range(40):
        solver.step()
        energies.append(energy(solver))
    change = ((masses * solver.velocities[0]).sum(0) - momentum).norm().item()
    substeps, dt = 40 * solver.substeps[0], solver.control_dt / solver.substeps[0]
    # A substep rounds every position twice (predict, project) by ulp(0.25 m) / 2, hence velocities by that over dt, at random.
    rounding = masses.sum().item() * 0.25 * FLOAT32_ULP / dt * np.sqrt(substeps)
    yield Check(
        test=test,
        what="change of linear momentum in 2 s of free flight [kg m/s]",
        equation="p = const",
        expected=0.0,
        measured=change,
        tolerance=rounding,
        why="random roundings of velocities by ulp / dt",
    )
    totals, bends = zip(*energies, strict=True)
    growth = max(later - earlier for earlier, later in zip(totals, totals[1:], strict=False))
    material = RopeMaterial()
    segment = solver.model.length / (solver.model.num_nodes - 1)
    softening = closed_forms.bend_softening(material.bend_stiffness, material.linear_density, segment, dt)
    yield Check(
        test=test,
        what="largest growth of kinetic + elastic energy per 0.05 s of free flight [J]",
        equation="dE <= 0",
        expected=0.0,
        measured=max(0.0, growth),
        tolerance=softening * max(bends) + 0.3 * rounding,
        why="bending acts softer by 3 EI dt^2/(rho l^4) than it is counted here; roundings times the speed",
    )


def spinning_rope(test: str, *, substeps: int) -> Iterator[Check]:
    """A straight rope spinning at omega_0 slows down as omega = omega_0 / sqrt(1 + 2 omega_0^2 dt t).

    Angular momentum is *not* conserved. With phi the angle of a substep, the chord of the last one moves a node outwards by
    r (1 - cos phi) and along the tangent by r sin phi, and the projection goes straight back to the circle:
    tan phi' = sin phi / (2 - cos phi), so phi' = phi - phi^3 + ..., d omega / dt = -omega^3 dt.
    """
    omega, seconds, control_dt = 4.0, 2.0, 0.05
    material = RopeMaterial(damping=0.0, stretch_stiffness=5e3, bend_stiffness=0.0)
    model = rope([[-0.4, 0, 0], [0.4, 0, 0]], num_nodes=21, material=material)
    solver = free_solver(model, substeps=substeps)
    solver.gravity.zero_()
    solver.velocities[..., 1] = omega * solver.positions[..., 0]
    masses = 1.0 / solver.inverse_masses[0, :, None].double()

    def angular_momentum() -> float:
        return torch.linalg.cross(solver.positions[0].double(), masses * solver.velocities[0]).sum(0).norm().item()

    start = angular_momentum()
    for _ in range(round(seconds / control_dt)):
        solver.step()
    dt = control_dt / substeps
    expected = 1.0 / np.sqrt(1.0 + 2.0 * omega**2 * dt * seconds)
    # Centrifugal strain changes the moment of inertia by 2 rho omega^2 (L/2)^2 / (2 EA); next order of the decay is (omega dt)^2.
    strain = material.linear_density * omega**2 * 0.4**2 / material.stretch_stiffness
    yield Check(
        test=test,
        what=f"L(2 s) / L(0) of a rope spinning at 4 rad/s, {substeps} substeps (continuous: 1)",
        equation="1 / sqrt(1 + 2 omega^2 dt t)",
        expected=float(expected),
        measured=angular_momentum() / start,
        tolerance=(omega * dt) ** 2 * omega * seconds + strain + FLOAT32_ULP * 0.4 / (omega * 0.4 * dt) * np.sqrt(seconds / dt),
        why="(omega dt)^2 per radian; strain; roundings of velocities",
    )


def pendulum(test: str, *, degrees: float) -> Iterator[Check]:
    """T / T0 = (2 / pi) K(sin^2(theta / 2)), T0 = 2 pi sqrt(L / g); small swings decay by omega^2 dt / 2 (implicit Euler)."""
    length, dt = 1.0, 2.5e-3
    material = RopeMaterial(linear_density=1e-3, stretch_stiffness=1e5, bend_stiffness=0.0, damping=0.0)
    start = np.radians(degrees)
    model = rope([[0, 0, 0], [length * np.sin(start), 0, -length * np.cos(start)]], num_nodes=3, material=material)
    solver = free_solver(model, control_dt=4 * dt, substeps=4)
    solver.inverse_masses[:, 0] = 0.0
    solver.inverse_masses[:, -1] = 1.0
    track = []
    for _ in range(1000):
        solver.step()
        track.append(solver.positions[0, -1].double().numpy().copy())
    angle = np.arctan2(np.array(track)[:, 0], -np.array(track)[:, 2])
    times = crossings(angle, 4 * dt)
    halves = 2.0 * np.diff(times) / (2.0 * np.pi * np.sqrt(length / GRAVITY))
    samples = (times / (4 * dt)).astype(int)
    amplitudes = np.array([np.abs(angle[a:b]).max() for a, b in zip(samples, samples[1:], strict=False)])
    expected = np.mean([closed_forms.pendulum_period_ratio(amplitude) for amplitude in amplitudes])
    # Sampled maxima miss less than theta (omega * 4 dt / 2)^2 / 2; numerical damping skews a swing by (omega dt)^2.
    omega = np.sqrt(GRAVITY / length)
    skew = (2.0 * omega * dt) ** 2 + float_strain(dt, length, GRAVITY * np.sin(amplitudes.min()))
    crossing = 2.0 * (omega * 4 * dt) ** 3 / 6.0
    yield Check(
        test=test,
        what=f"T / T0 of a pendulum released at {degrees:g} deg, mean over 10 s",
        equation="2/pi K(sin^2(theta/2)) at the measured amplitudes",
        expected=float(expected),
        measured=float(halves.mean()),
        tolerance=skew + crossing,
        why="(2 omega dt)^2; roundings of velocity; sampled amplitudes",
    )
    if degrees <= 10.0:
        rate = -np.polyfit(0.5 * (times[1:] + times[:-1]), np.log(amplitudes), 1)[0]
        damping = 0.5 * omega**2 * dt
        yield Check(
            test=test,
            what="decay rate of the amplitude, substep 2.5 ms [1/s]",
            equation="omega^2 dt / 2 (implicit Euler)",
            expected=damping,
            measured=float(rate),
            tolerance=0.15 * damping,
            why="sampled maxima: (omega 4 dt)^2 / 8 of a swing against ten swings' decay",
        )


def crossings(signal: np.ndarray, dt: float) -> np.ndarray:
    """Return the times [s] at which a sampled signal changes sign, interpolated linearly."""
    before = np.nonzero(signal[:-1] * signal[1:] < 0.0)[0]
    return dt * (1.0 + before + signal[before] / (signal[before] - signal[before + 1]))


def heavy_rope_mode(test: str, *, mode: int, num_nodes: int) -> Iterator[Check]:
    """Hanging rope: omega sqrt(L / g) = j_0k / 2 = 1.2024, 2.7600, 4.3269 (zeros of the Bessel function J0)."""
    length, amplitude, substeps, control_dt = 1.0, 0.01, 10, 0.01
    dt = control_dt / substeps
    frequency = closed_forms.heavy_rope_frequency(mode)
    omega = frequency * np.sqrt(GRAVITY / length)
    height = np.linspace(1.0, 0.0, 401)  # above the free end
    shape = j0(2.0 * frequency * np.sqrt(height))
    curve = np.stack([amplitude * shape, 0.0 * height, (height - 1.0) * length], axis=1)
    material = RopeMaterial(linear_density=0.05, stretch_stiffness=2e3, bend_stiffness=0.0, damping=0.0)
    solver = free_solver(rope(curve, num_nodes=num_nodes, material=material), control_dt=control_dt, substeps=substeps)
    solver.inverse_masses[:, 0] = 0.0
    weights = torch.as_tensor(np.interp(np.linspace(0.0, 1.0, num_nodes), 1.0 - height, shape), dtype=torch.float32)
    signal = []
    num_periods = 4
    for _ in range(int(num_periods * 2.0 * np.pi / omega / control_dt)):
        solver.step()
        signal.append(float((solver.positions[0, :, 0] * weights).sum()))
    times = crossings(np.array(signal), control_dt)
    measured = np.pi / np.diff(times).mean() * np.sqrt(length / GRAVITY)
    discrete = closed_forms.discrete_heavy_rope_frequency(mode, num_nodes)
    stretch = material.linear_density * GRAVITY * length / material.stretch_stiffness
    time_error = (omega * dt) ** 2 + (omega * control_dt) ** 3 / num_periods
    yield Check(
        test=test,
        what=f"omega sqrt(L/g) of mode {mode + 1} of a hanging rope, {num_nodes} nodes",
        equation="j_0k / 2",
        expected=frequency,
        measured=float(measured),
        tolerance=abs(discrete - frequency) + frequency * (stretch + time_error + 0.5 * amplitude + float_strain(dt, length)),
        why="exact eigenvalue of the discrete chain; strain; (omega dt)^2; amplitude; roundings",
    )


def taut_string(test: str, *, strain: float, num_nodes: int) -> Iterator[Check]:
    """A string under the tension T = EA strain swings with omega = pi / L sqrt(T / rho), whatever its segments and substeps.

    A projection in directions from before it would be unstable across the string from T = rho l^2 / (3 dt^2) on.
    """
    rest_length, amplitude, dt = 0.8, 1e-3, 2.5e-3
    material = RopeMaterial(bend_stiffness=0.0, damping=0.0)
    model = rope([[0, 0, 0], [rest_length, 0, 0]], num_nodes=num_nodes, material=material)
    solver = free_solver(model, control_dt=dt, substeps=1)
    solver.gravity.zero_()
    length, density = rest_length * (1.0 + strain), material.linear_density / (1.0 + strain)
    shape = torch.sin(torch.linspace(0.0, np.pi, num_nodes))
    solver.positions[..., 0] *= 1.0 + strain
    solver.positions[..., 1] = amplitude * shape
    solver.inverse_masses[:, [0, num_nodes - 1]] = 0.0
    tension = material.stretch_stiffness * strain
    omega = np.pi / length * np.sqrt(tension / density)
    num_periods = 4
    signal = []
    for _ in range(round((num_periods + 0.5) * 2.0 * np.pi / omega / dt)):
        solver.step()
        signal.append(float((solver.positions[0, :, 1] * shape).sum()))
    measured = np.pi / np.diff(crossings(np.array(signal), dt)).mean()
    limit = density * (length / (num_nodes - 1)) ** 2 / (3.0 * dt**2)
    lumping = (0.5 * np.pi / (num_nodes - 1)) ** 2 / 6.0
    # Swinging lengthens the string by (a pi / L)^2 / 4 on average at first.
    stiffening = 0.125 * (amplitude * np.pi / length) ** 2 / strain
    rounding = float_strain(dt, length, omega**2 * amplitude * np.exp(-0.5 * omega**2 * dt * dt * len(signal)))
    yield Check(
        test=test,
        what=f"omega of a string of {num_nodes} nodes, T = {tension / limit:.1f} rho l^2 / (3 dt^2) [1/s]",
        equation="pi / L sqrt(T / rho)",
        expected=float(omega),
        measured=float(measured),
        tolerance=omega * (0.5 * (omega * dt) ** 2 + lumping + stiffening + rounding / num_periods),
        why="(omega dt)^2 / 2 of implicit Euler; lumping; stretch by the amplitude; roundings of the last swing",
    )


def rest_is_rest(test: str, *, num_nodes: int, span: float) -> Iterator[Check]:
    """Kinetic energy goes to zero: a rope of 0.8 m held by its ends, with the default material and substeps."""
    model = rope([[0, 0, 0], [0.8, 0, 0]], num_nodes=num_nodes)
    solver = free_solver(model)
    arc = torch.linspace(0.0, np.pi, num_nodes)
    start = solver.positions.clone()
    start[..., 0] *= span
    start[..., 2] = -0.05 * torch.sin(arc)
    solver.reset(torch.tensor([0]), start, torch.tensor([0, num_nodes - 1]))
    for _ in range(400):
        solver.step()
    dt = solver.control_dt / solver.substeps[0]
    speed = solver.velocities.norm(dim=-1).max().item()
    yield Check(
        test=test,
        what=f"largest speed of a rope of {num_nodes} nodes after 20 s, ends at {span:g} of its length [m/s]",
        equation="v = 0 at rest",
        expected=0.0,
        measured=speed,
        tolerance=2.0 * FLOAT32_ULP * 0.8 / dt,
        why="a position that flips by one ulp per substep",
    )


CASES = [
    Case(test="T10", run=free_fall),
    Case(test="T10", run=free_flight),
    *[Case(test="T10", run=spinning_rope, options={"substeps": substeps}) for substeps in (10, 20, 40)],
    *[Case(test="T10", run=pendulum, options={"degrees": degrees}) for degrees in (10.0, 30.0, 60.0, 90.0)],
    *[
        Case(test="T10", run=heavy_rope_mode, options={"mode": mode, "num_nodes": num})
        for mode in (0, 1, 2)
        for num in (21, 41, 81)
    ],
    *[
        Case(test="T10", run=taut_string, options={"strain": strain, "num_nodes": num})
        for strain, num in ((0.001, 41), (0.003, 41), (0.01, 41), (0.03, 41), (0.01, 81))
    ],
    Case(test="T10", run=rest_is_rest, options={"num_nodes": 41, "span": 0.97}),
    Case(test="T10", run=rest_is_rest, options={"num_nodes": 41, "span": 0.99}),
    Case(test="T10", run=rest_is_rest, options={"num_nodes": 61, "span": 0.99}),
    Case(test="T10", run=rest_is_rest, options={"num_nodes": 41, "span": 0.998}),
]
