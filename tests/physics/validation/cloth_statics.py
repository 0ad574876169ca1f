"""T1, T2, T4, T5, T9, T13: cloth against closed forms of sheets."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from maniskill_grpd.physics import ClothMaterial, Model, Solver, cloth, rectangle_outline, square_outline
from maniskill_grpd.physics.colliders import cylinder, sphere

from . import closed_forms
from .closed_forms import FLOAT32_ULP, GRAVITY
from .record import Case, Check
from .rope_statics import drift_bound, float_strain


def upright(model: Model) -> torch.Tensor:
    """Return the rest shape with its y axis turned to z and its upper edge at z = 0, (1, N, 3)."""
    rest = torch.as_tensor(model.rest_positions)
    return torch.stack([rest[:, 0], torch.zeros(len(rest)), rest[:, 1] - rest[:, 1].max()], dim=1)[None]


def sheet_solver(model: Model, num_worlds: int = 1, **options) -> Solver:
    """Return worlds far above their table."""
    solver = Solver(model, num_worlds, 1, **options)
    solver.plane[:, 3] = -100.0
    return solver


def settle(solver: Solver, seconds: float) -> None:
    """Let the damped worlds come to rest."""
    for _ in range(round(seconds / solver.control_dt)):
        solver.step()


def stretch_softening(model: Model, dt: float) -> float:
    """Return the relative extra compliance that one coloured sweep leaves in stretch.

    A constraint does not see the projections that follow. In a smooth state those add up to -A_ii lambda_i, A = J W J^T, half
    of them following on average: extra compliance A_ii / 2 = w against 1 / (k dt^2). Lines of edges that are
    solved at once have less.
    """
    return float(dt**2 / (np.median(model.stretch_compliances) * np.median(model.masses)))


def bend_softening(model: Model, dt: float) -> float:
    """Return the same for bending, A_ii = sum_k weight_k^2 w_k, of hinges or of triples (1, -2, 1), whichever is more."""
    hinges = (model.hinge_weights.astype(float) ** 2 / model.masses[model.hinges]).sum(axis=1) / model.hinge_compliances
    triples = (np.array([1.0, 4.0, 1.0]) / model.masses[model.bends]).sum(axis=1) / model.bend_compliances
    return 0.5 * dt**2 * max(float(np.median(terms)) for terms in (hinges, triples) if len(terms))


def hanging_sheet(test: str, *, num_nodes: int, substeps: int = 100) -> Iterator[Check]:
    """Delta L = rho_A g L^2 / (2 E) for a strip hung by its upper edge, E in N/m, at every resolution."""
    length, width, stiffness, density = 0.5, 0.25, 20.0, 0.2
    material = ClothMaterial(
        area_density=density, stretch_stiffness=stiffness, bend_stiffness=0.0, damping=6.0, max_strain=np.inf
    )
    model = cloth(rectangle_outline(width, length), num_nodes=num_nodes, material=material)
    solver = sheet_solver(model, substeps=substeps)
    start = upright(model)
    solver.reset(torch.tensor([0]), start)
    solver.inverse_masses[:, start[0, :, 2] > -1e-6] = 0.0
    settle(solver, 4.0)
    bottom = start[0, :, 2] < -length + 1e-6
    measured = -solver.positions[0, bottom, 2].double().mean().item() - length
    expected = density * GRAVITY * length**2 / (2.0 * stiffness)
    dt = solver.control_dt / substeps
    strain = density * GRAVITY * length / stiffness
    # The held edge cannot narrow: within a third of the width the sheet is stiffer by 1 / (1 - nu^2) = 9/8, nu = 1/3, just where
    # it carries the most load. Springs are linear in their length, sheets in the strain: second order of the strain.
    clamp = 2.0 * (width / 3.0) / length / 9.0
    yield Check(
        test=test,
        what=f"elongation of a hanging sheet, {model.num_nodes} nodes [m]",
        equation="rho_A g L^2 / (2 E)",
        expected=expected,
        measured=measured,
        tolerance=expected * (clamp + strain + stretch_softening(model, dt) + float_strain(dt, length)) + drift_bound(solver),
        why="edge that cannot narrow; second order of the strain; softening k dt^2/m of the sweep; roundings",
    )


def substep_independence(test: str) -> Iterator[Check]:
    """The same sheet with 50, 100 and 200 substeps: a compliance is a constant of the material."""
    runs = {substeps: next(hanging_sheet(test, num_nodes=60, substeps=substeps)) for substeps in (50, 100, 200)}
    reference = runs[200].measured
    material = ClothMaterial(area_density=0.2, stretch_stiffness=20.0, bend_stiffness=0.0)
    model = cloth(rectangle_outline(0.25, 0.5), num_nodes=60, material=material)
    for substeps in (50, 100):
        tolerance = reference * (stretch_softening(model, 0.05 / substeps) + float_strain(0.05 / 200, 0.5))
        yield Check(
            test=test,
            what=f"elongation of a hanging sheet, {substeps} substeps [m]",
            equation="elongation at 200 substeps",
            expected=reference,
            measured=runs[substeps].measured,
            tolerance=tolerance,
            why="softening k dt^2/m of the sweep; roundings",
        )


def sheet_cantilever(test: str, *, gamma: float, along: int = 12) -> Iterator[Check]:
    """Heavy elastica of a strip, Gamma = rho_A g L^3 / B; Peirce: 41.5 deg at Gamma = 8.004, c = (B / w)^(1/3) = L / 2."""
    length, density = 0.5, 0.2
    segment = length / (along - 1.5)
    bend = density * GRAVITY * length**3 / gamma
    material = ClothMaterial(
        area_density=density,
        stretch_stiffness=1e3 * density * GRAVITY * length,
        bend_stiffness=bend,
        damping=6.0,
        max_strain=np.inf,
    )
    across = 4
    outline = rectangle_outline(segment * (along - 1), segment * (across - 1))
    model = cloth(outline, num_nodes=along * across, material=material)
    ratio = np.sqrt(FLOAT32_ULP * gamma / (3.0 * (along - 1.5) ** 4))
    substeps = round(0.05 / np.sqrt(ratio * length / GRAVITY))
    solver = sheet_solver(model, substeps=substeps)
    left = model.rest_positions[:, 0].min()
    x = torch.as_tensor(model.rest_positions[:, 0] - left)
    columns = np.unique(np.round(x.numpy() / segment, 3))
    clamped = x < 1.5 * float(columns[1]) * segment
    solver.inverse_masses[:, clamped] = 0.0
    settle(solver, 6.0)
    tip = x > x.max() - 0.5 * segment
    end = solver.positions[0, tip].double().mean(dim=0).numpy()
    clamp = left + float(x[clamped].max()) - 0.5 * segment
    beam = float(x.max()) - float(x[clamped].max()) + 0.5 * segment
    actual = gamma * (beam / length) ** 3
    reach, drop = closed_forms.heavy_elastica(actual)
    measured_reach, measured_drop = (end[0] - clamp) / beam, -end[2] / beam
    dt = solver.control_dt / substeps
    softer = closed_forms.heavy_elastica(actual * 1.001)
    softening = bend_softening(model, dt) + float_strain(dt, length)
    lumping = (segment / beam) ** 2 * (1.0 + min(gamma, 8.0) ** 2 / 96.0)
    why = "(l/L)^2 of the hinges; softening of the sweep, A_ii dt^2 / (2 compliance); roundings"
    for name, measured, expected, slope in (
        ("drop/L", measured_drop, drop, (softer[1] - drop) / 1e-3),
        ("X/L", measured_reach, reach, (softer[0] - reach) / 1e-3),
    ):
        yield Check(
            test=test,
            what=f"{name} of an overhanging strip, Gamma = {actual:.3g}, {along} x {across} nodes",
            equation="heavy elastica (strip of cloth)",
            expected=expected,
            measured=measured,
            tolerance=lumping * max(expected, 0.2) + abs(slope) * softening + 1e-3 + drift_bound(solver),
            why=why,
        )
    if test == "T5":
        angle, closed = np.degrees(np.arctan2(measured_drop, measured_reach)), np.degrees(np.arctan2(drop, reach))
        sensitivity = abs(np.degrees(np.arctan2(softer[1], softer[0])) - closed) / 1e-3
        yield Check(
            test=test,
            what="chord angle of a strip that overhangs by twice its bending length [deg]",
            equation="41.5 deg at L = 2 (B / w)^(1/3) (ASTM D1388)",
            expected=float(closed),
            measured=float(angle),
            tolerance=sensitivity * softening + np.degrees(lumping) + np.degrees(drift_bound(solver) / beam),
            why=why,
        )


def membrane(test: str, *, num_nodes: int) -> Iterator[Check]:
    """A strip pulled by a strain e without gravity: force E w e, width w (1 - nu e) with nu = 1/3."""
    length, width, stiffness, strain, substeps = 0.6, 0.2, 20.0, 0.02, 100
    material = ClothMaterial(stretch_stiffness=stiffness, bend_stiffness=0.0, damping=10.0, max_strain=np.inf)
    model = cloth(rectangle_outline(length, width), num_nodes=num_nodes, material=material)
    solver = sheet_solver(model, substeps=substeps)
    solver.gravity.zero_()
    start = torch.as_tensor(model.rest_positions)[None].clone()
    start[..., 0] *= 1.0 + strain
    solver.reset(torch.tensor([0]), start)
    rest = model.rest_positions
    ends = np.abs(rest[:, 0]) > 0.5 * length - 1e-6
    solver.inverse_masses[:, ends] = 0.0
    settle(solver, 5.0)
    x = solver.positions[0].double().numpy()
    i, j = model.edges.T
    spring = x[j] - x[i]
    now = np.linalg.norm(spring, axis=1)
    tension = (now - model.rest_lengths) / model.stretch_compliances
    cut = (np.minimum(rest[i, 0], rest[j, 0]) <= 1e-4) & (np.maximum(rest[i, 0], rest[j, 0]) > 1e-4)
    force = (tension[cut] * np.abs(spring[cut, 0]) / now[cut]).sum()
    middle = np.abs(rest[:, 0]) < 0.15 * length
    slope = np.polyfit(rest[middle, 1], x[middle, 1] - rest[middle, 1], 1)[0]
    # The ends cannot narrow: within a third of the width of each the strip is stiffer by 9/8.
    clamp = 2.0 * (width / 3.0) / length / 8.0
    yield Check(
        test=test,
        what=f"force of a strip pulled by 2 %, {model.num_nodes} nodes [N]",
        equation="E w e",
        expected=stiffness * width * strain,
        measured=float(force),
        tolerance=stiffness * width * strain * (clamp + 2.0 * strain + 1.0 / np.sqrt(model.num_nodes)),
        why="ends that cannot narrow; second order of the strain; fit of springs at the rim, one row in sqrt(N)",
    )
    yield Check(
        test=test,
        what=f"transverse strain of the strip, {model.num_nodes} nodes",
        equation="-nu e, nu = 1/3",
        expected=-strain / 3.0,
        measured=float(slope),
        tolerance=strain / 3.0 * (np.exp(-0.35 * length / width * np.pi) + 2.0 * strain + 2.0 / np.sqrt(model.num_nodes)),
        why="decay of the ends' effect (Saint-Venant); second order of the strain; rim rows",
    )


def drape(test: str) -> Iterator[Check]:
    """A square draped over a sphere keeps the symmetry of the square, stays outside, and is not strained."""
    model = cloth(square_outline(0.3), num_nodes=169)
    solver = sheet_solver(model, colliders=[sphere(0.08)])
    start = torch.as_tensor(model.rest_positions)[None] + torch.tensor([0.0, 0.0, 0.09])
    solver.reset(torch.tensor([0]), start)
    settle(solver, 4.0)
    x = solver.positions[0].double()
    rest = torch.as_tensor(model.rest_positions).double()
    turned = torch.stack([-rest[:, 1], rest[:, 0], rest[:, 2]], dim=1)
    partner = torch.cdist(turned, rest).argmin(dim=1)
    heights = (x[:, 2] - x[partner, 2]).abs()
    i, j = (torch.as_tensor(side, dtype=torch.long) for side in model.edges.T)
    strain = ((x[i] - x[j]).norm(dim=-1) / torch.as_tensor(model.rest_lengths) - 1.0).abs()
    depth = (0.08 + model.radius - x.norm(dim=-1)).clamp(min=0.0)
    yield Check(
        test=test,
        what="p99 edge strain of a cloth draped over a sphere",
        equation="< 0.05",
        expected=0.0,
        measured=torch.quantile(strain, 0.99).item(),
        tolerance=0.05,
        why="required bound",
    )
    yield Check(
        test=test,
        what="p99 penetration of the sphere [m]",
        equation="< radius",
        expected=0.0,
        measured=torch.quantile(depth, 0.99).item(),
        tolerance=0.5 * model.radius,
        why="required: half the thickness",
    )
    yield Check(
        test=test,
        what="median difference of heights under a quarter turn [m]",
        equation="0 by symmetry",
        expected=0.0,
        measured=heights.median().item(),
        tolerance=0.3 / 12,
        why="folds break the symmetry of the square in a place that the mesh's diagonals choose: one mesh width",
    )


def drape_coefficient(model: Model) -> float:
    """Return (shadow - disc) / (cloth - disc) of a cloth draped over a disc of radius 0.09 m (Cusick)."""
    disc = 0.09
    solver = sheet_solver(model, colliders=[cylinder(disc, 0.01)])
    start = torch.as_tensor(model.rest_positions)[None] + torch.tensor([0.0, 0.0, 0.014])
    solver.reset(torch.tensor([0]), start)
    settle(solver, 4.0)
    points = solver.positions[0, :, :2].double().numpy()
    rim = points[model.node_sets["boundary"]]
    angles = np.unwrap(np.arctan2(rim[:, 1], rim[:, 0]))
    radii = np.linalg.norm(rim, axis=1)
    order = np.argsort(angles)
    angles, radii = np.append(angles[order], angles[order][0] + 2.0 * np.pi), np.append(radii[order], radii[order][0])
    shadow = 0.5 * np.trapezoid(radii**2, angles)
    rest = np.linalg.norm(model.rest_positions[model.node_sets["boundary"]], axis=1).mean()
    return float((shadow - np.pi * disc**2) / (np.pi * rest**2 - np.pi * disc**2))


def cusick(test: str) -> Iterator[Check]:
    """Cusick drape, a disc of cloth over a smaller one: between 0 (limp) and 1 (rigid), and it grows with the rigidity."""
    from maniskill_grpd.physics import circle_outline

    values = [
        drape_coefficient(cloth(circle_outline(0.15), num_nodes=300, material=ClothMaterial(bend_stiffness=bend, damping=4.0)))
        for bend in (1e-6, 1e-4, 1e-2)
    ]
    series = ", ".join(f"{value:.2f}" for value in values)
    smallest_rise = min(later - earlier for earlier, later in zip(values, values[1:], strict=False))
    yield Check(
        test=test,
        what="drape coefficient at B = 1e-2 N m (Gamma = 0.04 for the 6 cm that overhang)",
        equation="1 (rigid)",
        expected=1.0,
        measured=values[-1],
        tolerance=0.1,
        why="drop c Gamma / 8 hardly shortens the shadow; faceted rim",
    )
    yield Check(
        test=test,
        what=f"smallest rise of the drape coefficient over B = 1e-6, 1e-4, 1e-2 N m ({series})",
        equation="> 0",
        expected=max(smallest_rise, 0.0),
        measured=smallest_rise,
        tolerance=0.0,
        why="stiffer cloth drapes less",
    )


CASES = [
    *[Case(test="T1", run=hanging_sheet, options={"num_nodes": num}) for num in (28, 60, 120, 231)],
    Case(test="T2", run=substep_independence),
    *[Case(test="T4", run=sheet_cantilever, options={"gamma": gamma}) for gamma in (1.0, 2.0, 4.0, 16.0)],
    Case(test="T5", run=sheet_cantilever, options={"gamma": 8.004}),
    *[Case(test="T9", run=membrane, options={"num_nodes": num}) for num in (75, 300)],
    Case(test="T13", run=drape),
    Case(test="T13", run=cusick),
]
