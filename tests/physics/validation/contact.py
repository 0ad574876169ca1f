"""T11 and T12: Coulomb friction and contact, against planes, boxes and cylinders."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from maniskill_grpd.physics import RopeMaterial, Solver, cloth, rope, square_outline
from maniskill_grpd.physics.colliders import box, cylinder, sphere

from . import closed_forms
from .closed_forms import FLOAT32_ULP, GRAVITY
from .record import Case, Check


def incline(test: str, *, friction: float, margin: float) -> Iterator[Check]:
    """A body on a slope rests while tan(slope) <= mu, else it slides with g (sin - mu cos)."""
    slope = np.arctan(friction) + margin
    material = RopeMaterial(friction=friction, damping=0.0)
    model = rope([[0, -0.2, 0], [0, 0.2, 0]], num_nodes=21, radius=0.01, material=material)
    solver = Solver(model, 1, 2)
    solver.gravity[0] = GRAVITY * torch.tensor([np.sin(slope), 0.0, -np.cos(slope)])
    solver.positions[..., 2] = 0.01
    for _ in range(10):
        solver.step()
    time, dt = 10 * solver.control_dt, solver.control_dt / solver.substeps[0]
    acceleration = max(0.0, GRAVITY * (np.sin(slope) - friction * np.cos(slope)))
    sliding = acceleration > 0.0
    # Symplectic Euler is ahead by a t dt / 2; a node at rest creeps by at most an ulp of its coordinate per substep.
    tolerance = 0.5 * GRAVITY * time * dt * np.sin(slope) if sliding else 10 * solver.substeps[0] * FLOAT32_ULP * 0.01
    yield Check(
        test=test,
        what=f"distance in 0.5 s on an incline of {np.degrees(slope):.2f} deg, mu = {friction:g} [m]",
        equation="g (sin - mu cos) t^2 / 2" if sliding else "0 (stick)",
        expected=0.5 * acceleration * time**2,
        measured=solver.positions[0, :, 0].mean().item(),
        tolerance=tolerance,
        why="first order: g sin t dt / 2" if sliding else "one ulp of 1 cm per substep",
    )


def friction_angle(test: str, *, friction: float) -> Iterator[Check]:
    """The slope at which a body starts to slide is arctan(mu): 16.70, 26.57 and 45 deg for 0.3, 0.5 and 1."""
    count, spread = 65, 1.0
    expected = np.degrees(np.arctan(friction))
    slopes = np.radians(expected + np.linspace(-spread, spread, count))
    model = rope([[0, -0.2, 0], [0, 0.2, 0]], num_nodes=11, radius=0.01, material=RopeMaterial(friction=friction, damping=0.0))
    solver = Solver(model, count, 1)
    down = np.stack([np.sin(slopes), 0.0 * slopes, -np.cos(slopes)], axis=1)
    solver.gravity.copy_(torch.as_tensor(GRAVITY * down, dtype=torch.float32))
    solver.positions[..., 2] = 0.01
    for _ in range(40):
        solver.step()
    slides = solver.positions[..., 0].mean(dim=1) > 1e-4
    measured = np.degrees(slopes[int(slides.int().argmax())])
    resolution = 2.0 * spread / (count - 1)
    # The cone is compared in float32 against a depth g cos dt^2 that is itself rounded at the height of 1 cm.
    dt = solver.control_dt / solver.substeps[0]
    rounding = np.degrees(FLOAT32_ULP * 0.01 / (GRAVITY * dt**2))
    yield Check(
        test=test,
        what=f"slope at which sliding starts, mu = {friction:g} [deg]",
        equation="arctan(mu)",
        expected=expected,
        measured=measured,
        tolerance=resolution + 2.0 * rounding,
        why="spacing of the slopes tried; rounding of the depth",
    )


def overhang(test: str, *, friction: float) -> Iterator[Check]:
    """A rope hanging over the edge of a table slides when more than mu / (1 + mu) of it hangs, more with friction at the edge.

    Worlds differ in the fraction that hangs. Nodes are closer than the rope's radius, so the edge acts as a round one; T along it
    follows dT / dphi = mu (T + w R cos phi) - w R sin phi.
    """
    count, num_nodes, length, radius = 41, 151, 0.6, 0.015
    critical = closed_forms.sliding_overhang(friction, length, radius)
    fractions = np.linspace(0.8, 1.2, count) * critical
    material = RopeMaterial(linear_density=0.05, stretch_stiffness=200.0, bend_stiffness=0.0, friction=friction, damping=0.5)
    model = rope([[0, 0, 0], [length, 0, 0]], num_nodes=num_nodes, radius=radius, material=material)
    solver = Solver(model, count, 1, substeps=80, colliders=[box(1.0, 0.5, 0.5)])
    solver.plane[:, 3] = -100.0
    solver.collider_positions[:, 0] = torch.tensor([-1.0 - radius, 0.0, -0.5 - radius])
    arc = np.linspace(0.0, length, num_nodes)
    beyond = arc - ((1.0 - fractions[:, None]) * length - 0.5 * np.pi * radius)  # path behind the start of the round edge
    angle = np.clip(beyond / radius, 0.0, 0.5 * np.pi)
    x = np.minimum(beyond, 0.0) - radius * (1.0 - np.sin(angle))
    z = -radius * (1.0 - np.cos(angle)) - np.maximum(beyond - 0.5 * np.pi * radius, 0.0)
    start = np.stack([x, 0.0 * x, z], axis=-1)
    solver.reset(torch.arange(count), torch.as_tensor(start, dtype=torch.float32))
    for _ in range(40):
        solver.step()
    moved = solver.positions[:, 0, 0].double().numpy() - start[:, 0, 0]
    # What slides to a new rest moves less than the whole range of fractions; what slides off moves by most of its length.
    measured = fractions[int((moved > 0.2 * length).argmax())]
    # A rope that is not yet taut first takes up its strain; the millimetres by which it moves count as hanging.
    settling = moved[moved < 0.2 * length].max() / length if (moved < 0.2 * length).any() else np.nan
    yield Check(
        test=test,
        what=f"hanging fraction at which a rope slides off a table, mu = {friction:g}",
        equation="capstan with weight over the edge",
        expected=critical,
        measured=float(measured),
        tolerance=settling + 1.0 / (num_nodes - 1) + fractions[1] - fractions[0],
        why="creep before it holds; one segment; spacing of the worlds",
    )


def capstan(test: str, *, friction: float) -> Iterator[Check]:
    """T2 / T1 = exp(mu phi): over a cylinder (phi = pi) the heavier end sinks if it pulls exp(mu pi) times the other."""
    count, num_nodes, radius, drum, tail = 33, 97, 0.004, 0.1, 0.25
    closed_form = np.exp(friction * np.pi)
    ratios = np.linspace(0.8, 1.2, count) * closed_form
    turn = np.pi * (drum + radius)
    material = RopeMaterial(linear_density=0.02, stretch_stiffness=500.0, bend_stiffness=0.0, friction=friction, damping=1.0)
    model = rope([[0, 0, 0], [2 * tail + turn, 0, 0]], num_nodes=num_nodes, radius=radius, material=material)
    light = 0.05
    solver = Solver(model, count, 1, colliders=[cylinder(drum, 0.5)])
    solver.plane[:, 3] = -100.0
    half = np.sqrt(0.5)
    solver.collider_rotations[:, 0] = torch.tensor([half, half, 0.0, 0.0])  # axis z of the cylinder along y
    arc = np.linspace(0.0, model.length, num_nodes)
    angle = np.clip((arc - tail) / (drum + radius), 0.0, np.pi)
    start = np.zeros((num_nodes, 3))
    start[:, 0] = -(drum + radius) * np.cos(angle)
    start[:, 2] = (drum + radius) * np.sin(angle) - np.maximum(tail - arc, 0.0) - np.maximum(arc - tail - turn, 0.0)
    solver.reset(torch.arange(count), torch.as_tensor(start, dtype=torch.float32).expand(count, -1, -1).contiguous())
    # The straight ends of the rope pull as well: end masses are such that the tensions at the drum have the wanted ratios.
    own = material.linear_density * tail
    solver.inverse_masses[:, 0] = 1.0 / light
    solver.inverse_masses[:, -1] = torch.as_tensor(1.0 / (ratios * (light + own) - own), dtype=torch.float32)
    for _ in range(40):
        solver.step()
    sunk = start[-1, 2] - solver.positions[:, -1, 2].double().numpy()
    # Near the threshold the end sinks with g (ratio - closed form) / (ratio + 1): 2 s show what is 1 % above it.
    slides = sunk > 0.05
    measured = ratios[int(slides.argmax())] if slides.any() else np.nan
    delta = model.length / (num_nodes - 1) / (drum + radius)
    arc_weight = material.linear_density * (drum + radius) / (light + own) * (1.0 + friction)
    yield Check(
        test=test,
        what=f"tension ratio that a half turn holds, mu = {friction:g}",
        equation="exp(mu pi)",
        expected=closed_form,
        measured=float(measured),
        tolerance=closed_form * (friction * delta + arc_weight + 0.02) + (ratios[1] - ratios[0]),
        why="one contact more or less on the polygon, mu delta; weight of the rope on the drum; 1 % to be seen in 2 s; spacing",
    )


def dropped_rope(test: str) -> Iterator[Check]:
    """A rope dropped on the table rests at its radius, and never enters the table at the end of a substep."""
    model = rope([[0, 0, 0.2], [0.4, 0, 0.3]], num_nodes=21)
    solver = Solver(model, 1, 2)
    lowest = np.inf
    for _ in range(60):
        solver.step()
        lowest = min(lowest, solver.positions[..., 2].min().item())
    rounding = 0.5 * FLOAT32_ULP
    yield Check(
        test=test,
        what="deepest penetration of the table while falling and at rest [m]",
        equation="0",
        expected=0.0,
        measured=max(0.0, model.radius - lowest),
        tolerance=rounding,
        why="contact is the last projection of a substep; rounding",
    )
    yield Check(
        test=test,
        what="height of the highest node at rest [m]",
        equation="radius",
        expected=model.radius,
        measured=solver.positions[..., 2].max().item(),
        tolerance=rounding + GRAVITY * 0.05**2 / solver.substeps[0] ** 2,
        why="one substep of gravity",
    )


def full_speed(test: str, *, thing: str, shape: str) -> Iterator[Check]:
    """An object dragged over a collider at the grippers' full speed of 0.6 m/s penetrates by less than half its thickness (p99).

    A node moves 1.5 mm in a substep, against a radius of 10 mm (rope) or 3 mm (cloth): it cannot tunnel, only be pushed.
    """
    collider = {"sphere": sphere(0.1), "box": box(0.1, 0.1, 0.1), "cylinder": cylinder(0.1, 0.1)}
    num_worlds = 16
    model = rope([[-0.4, 0, 0], [0.4, 0, 0]], num_nodes=41) if thing == "rope" else cloth(square_outline(0.4), num_nodes=100)
    solver = Solver(model, num_worlds, 2, colliders=[collider[shape]])
    solver.plane[:, 3] = -1.0
    start = torch.as_tensor(model.rest_positions).expand(num_worlds, -1, -1) + torch.tensor([0.0, 0.0, 0.2])
    solver.reset(torch.arange(num_worlds), start.contiguous(), torch.tensor([0, model.num_nodes - 1]))
    generator = torch.Generator().manual_seed(0)
    depths = []
    for step in range(60):
        if step % 10 == 0:
            direction = torch.randn(num_worlds, 2, 3, generator=generator)
            if step < 20:
                direction = torch.tensor([0.0, 0.0, -1.0]).expand(num_worlds, 2, 3)
        move = 0.03 * direction / direction.norm(dim=-1, keepdim=True)
        solver.gripper_targets.copy_(solver.gripper_positions + move)
        solver.step()
        free = solver.holder < 0
        depths.append((model.radius - surface_distance(shape, solver.positions))[free].clamp(min=0.0))
    depth = torch.cat(depths).double().numpy()
    yield Check(
        test=test,
        what=f"p99 penetration of a {thing} dragged over a {shape} at 0.6 m/s [m]",
        equation="0",
        expected=0.0,
        measured=float(np.quantile(depth, 0.99)),
        tolerance=model.radius,
        why="half the thickness",
    )
    yield Check(
        test=test,
        what=f"largest penetration of a {shape} by a {thing} dragged at 0.6 m/s [m]",
        equation="0",
        expected=0.0,
        measured=float(depth.max()),
        tolerance=model.radius + 0.6 * solver.control_dt / solver.substeps[0],
        why="radius plus the motion of one substep: more would be tunnelling",
    )


def surface_distance(shape: str, points: torch.Tensor) -> torch.Tensor:
    """Return the signed distance [m] of points (..., 3) from a collider of size 0.1 m at the origin."""
    if shape == "sphere":
        return points.norm(dim=-1) - 0.1
    if shape == "box":
        outside = points.abs() - 0.1
    else:
        outside = torch.stack([points[..., :2].norm(dim=-1) - 0.1, points[..., 2].abs() - 0.1], dim=-1)
    return outside.clamp(min=0.0).norm(dim=-1) + outside.amax(dim=-1).clamp(max=0.0)


CASES = [
    *[
        Case(test="T11", run=incline, options={"friction": mu, "margin": margin})
        for mu in (0.3, 0.5, 1.0)
        for margin in (-0.01, 0.01, 0.06)
    ],
    *[Case(test="T11", run=friction_angle, options={"friction": mu}) for mu in (0.3, 0.5, 1.0)],
    *[Case(test="T11", run=overhang, options={"friction": mu}) for mu in (0.3, 0.5)],
    *[Case(test="T11", run=capstan, options={"friction": mu}) for mu in (0.1, 0.3, 0.5)],
    Case(test="T12", run=dropped_rope),
    *[
        Case(test="T12", run=full_speed, options={"thing": thing, "shape": shape})
        for thing in ("rope", "cloth")
        for shape in ("sphere", "box", "cylinder")
    ],
]
