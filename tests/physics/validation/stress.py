"""Worlds of every shape, resolution and collider, driven at full speed and with absurd actions."""

from __future__ import annotations

import numpy as np
import torch

from maniskill_grpd.physics import (
    Solver,
    circle_outline,
    cloth,
    hexagon_outline,
    l_shape_outline,
    rectangle_outline,
    rope,
    square_outline,
    triangle_outline,
)
from maniskill_grpd.physics.colliders import box, capsule, cylinder, plane, prism, sphere

MAX_STEP = 0.03
ABSURD = ("teleport", "100x speed", "non-finite", "flip")


def all_models(resolutions: tuple[int, ...]) -> list:
    """Return a rope and every outline, with and without a hole, at each resolution."""
    hole = [circle_outline(0.04, num_points=12)]
    outlines = [
        (square_outline(0.3), hole),
        (rectangle_outline(0.4, 0.2), hole),
        (triangle_outline(0.45), hole),
        (hexagon_outline(0.2), hole),
        (circle_outline(0.17), hole),
        (l_shape_outline(0.4), [circle_outline(0.03, (-0.1, -0.1), 12)]),
    ]
    models = []
    for num_nodes in resolutions:
        models.append(rope([[-0.3, 0, 0], [0.0, 0.1, 0], [0.3, 0, 0]], num_nodes=max(20, min(num_nodes, 120))))
        for outline, holes in outlines:
            models += [cloth(outline, num_nodes=num_nodes), cloth(outline, holes, num_nodes=num_nodes)]
    return models


def stress_solver(models: list, num_worlds: int, *, self_collision: bool) -> Solver:
    """Return worlds that cycle through the models, each with one of the colliders switched on."""
    octagon = 0.08 * np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=1)
    colliders = [plane(), sphere(0.08), capsule(0.05, 0.1), box(0.08, 0.08, 0.04), cylinder(0.08, 0.1), prism(octagon, 0.05)]
    solver = Solver(models, num_worlds, 3, colliders=colliders, self_collision=self_collision)
    worlds = torch.arange(num_worlds)
    solver.collider_active[:] = torch.nn.functional.one_hot(worlds % len(colliders), len(colliders)).bool()
    solver.plane[:, 3] = -0.3
    reset_worlds(solver, worlds)
    return solver


def reset_worlds(solver: Solver, worlds: torch.Tensor) -> None:
    """Put worlds flat above the colliders, held at three nodes."""
    if len(worlds) == 0:
        return
    variants = worlds % len(solver.models)
    positions = torch.zeros(len(worlds), solver.positions.shape[1], 3)
    nodes = torch.zeros(len(worlds), 3, dtype=torch.int64)
    for row, variant in enumerate(variants.tolist()):
        rest = torch.as_tensor(solver.models[variant].rest_positions)
        positions[row, : len(rest)] = rest + torch.tensor([0.0, 0.0, 0.15])
        nodes[row] = torch.tensor([0, len(rest) // 2, len(rest) - 1])
    solver.reset(worlds, positions, nodes, variants=variants)


def absurd_targets(solver: Solver, generator: torch.Generator) -> None:
    """Overwrite the targets of a few worlds: teleports, 100x speed, infinities, swapped grippers."""
    for kind in ABSURD:
        world = int(torch.randint(solver.num_worlds, (1,), generator=generator))
        targets, here = solver.gripper_targets[world], solver.gripper_positions[world]
        if kind == "teleport":
            targets[:] = 1e3 * torch.randn(3, 3, generator=generator)
        elif kind == "100x speed":
            targets[:] = here + 100.0 * MAX_STEP * torch.randn(3, 3, generator=generator)
        elif kind == "non-finite":
            targets[0, 0] = float("nan") if torch.rand(1, generator=generator) < 0.5 else float("inf")
        else:
            targets[:] = here.flip(0)


def run_stress(solver: Solver, num_steps: int, *, absurd_every: int, seed: int = 0) -> dict[str, float]:
    """Drive all worlds by random full-speed moves, check every state, and reset what froze.

    Raises:
        AssertionError: If a non-finite number appears in any state.
    """
    generator = torch.Generator().manual_seed(seed)
    frozen_total, farthest = 0, 0.0
    for step in range(num_steps):
        if step % 10 == 0:
            move = torch.randn(solver.num_worlds, 3, 3, generator=generator)
            move = MAX_STEP * move / move.norm(dim=-1, keepdim=True)
        solver.gripper_targets.copy_(solver.gripper_positions + move)
        solver.gripper_targets.clamp_(-1.0, 1.0)
        if absurd_every and step % absurd_every == 0:
            absurd_targets(solver, generator)
        solver.step()
        assert torch.isfinite(solver.positions).all(), f"a position is not finite after step {step}"
        assert torch.isfinite(solver.velocities).all(), f"a velocity is not finite after step {step}"
        frozen = solver.frozen.nonzero()[:, 0]
        reset_worlds(solver, frozen)
        assert not solver.frozen.any(), "a reset did not bring a frozen world back"
        frozen_total += len(frozen)
        if step % 50 == 49:
            reset_worlds(solver, torch.arange(step // 50 % 2, solver.num_worlds, 2))
        farthest = max(farthest, solver.positions.abs().max().item())
    return {"world_steps": num_steps * solver.num_worlds, "frozen": frozen_total, "farthest": farthest}
