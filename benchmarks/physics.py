"""Measure the solver beside Newton's XPBD and VBD on the same objects at equal stretch, in one run.

taskset -c 0 python benchmarks/physics.py [--quick] [--scene NAME] [--json FILE] [--device cpu] [--target X]

Every solver moves the same springs, masses, hinges and table through the same motion: two held nodes are dragged at 0.6 m/s in
directions that change every half second. The largest edge strain that ours reaches with its default substeps is the target, but
no less than 1 %; Newton's substeps and iterations are searched for the cheapest setting that stays below it. Then all take turns,
each on one thread, pinned by `taskset`; on CPU the time of the processor counts, so that other processes do not. `ratio` is ours
over the faster of Newton's two; "springs only" leaves out bending and table, which ours computes. Needs the extra `newton`;
without it only ours is measured.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import asdict, dataclass, field
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import torch
from machine import describe_machine, measure_peaks, report, save
from physics_cost import count_work

from maniskill_grpd.physics import Model, Solver, cloth, rope, square_outline

MAX_STEP = 0.03
SLOW = 5.0  # a configuration that would take longer than this [s] for one control step is not measured
PATIENCE = 60.0  # longest search for the setting of one solver [s]
SMALLEST_TARGET = 0.01  # a stretch of 1 % is good enough for everyone
SUBSTEPS = {
    "xpbd": (10, 15, 20, 30, 40, 50, 60, 80, 100, 120, 140, 160, 200, 250, 320, 400, 500, 640, 800, 1600),
    "vbd": (2, 3, 5, 7, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240, 320),
}
ITERATIONS = {"xpbd": (1, 2, 4, 10), "vbd": (1, 3, 5, 10, 20)}
MOST_SWEEPS = 1600  # substeps times iterations


@dataclass(frozen=True)
class Scene:
    """An object and the two nodes that are held."""

    name: str
    model: Model
    held: np.ndarray


@dataclass
class Entry:
    """One solver in one scene with the setting it needs."""

    scene: Scene
    solver: str
    substeps: int
    iterations: int
    stretch: float
    rates: dict[int, list[float]] = field(default_factory=dict)


def scenes(quick: bool) -> list[Scene]:
    """Return the rope and the cloths."""
    found = []
    for side in (10,) if quick else (10, 15, 35):
        model = cloth(square_outline(0.4), num_nodes=side**2)
        found.append(Scene(f"cloth {side}x{side}", model, model.node_sets["corners"][:2]))
    span = np.linspace(0.0, 1.0, 200)
    arch = np.stack([0.8 * span - 0.4, 0.0 * span, -0.15 * np.sin(np.pi * span)], axis=1)  # the rope hangs between its ends
    found.insert(1, Scene("rope 40", rope(arch, num_nodes=40), np.array([0, 39])))
    return found


def motion(num_worlds: int, num_steps: int) -> np.ndarray:
    """Return the displacement of the held nodes in every step, (T, B, 3) float32 [m]: both go the same way at full speed."""
    direction = np.random.default_rng(0).normal(size=(num_steps // 10 + 1, num_worlds, 3)).repeat(10, axis=0)[:num_steps]
    return (MAX_STEP * direction / np.linalg.norm(direction, axis=-1, keepdims=True)).astype(np.float32)


class Ours:
    """This package behind the three calls that the benchmark makes."""

    def __init__(self, scene: Scene, num_worlds: int, substeps: int, device: str) -> None:
        self.solver = Solver(scene.model, num_worlds, 2, substeps=substeps, device=device, num_threads=1)
        self.solver.plane[:, 3] = -10.0
        worlds = torch.arange(num_worlds, device=device)
        start = torch.as_tensor(scene.model.rest_positions, device=device).expand(num_worlds, -1, -1)
        self.solver.reset(worlds, start.contiguous(), torch.as_tensor(scene.held, device=device))

    def step(self, move: np.ndarray) -> None:
        """Move the held nodes by (B, 3) and advance one control step."""
        delta = torch.from_numpy(move).to(self.solver.device)[:, None]
        self.solver.gripper_targets.copy_(self.solver.gripper_positions + delta)
        self.solver.step()

    def wait(self) -> None:
        """Wait for the device."""
        if self.solver.device.type == "cuda":
            torch.cuda.synchronize()

    def positions(self) -> np.ndarray:
        """Return node positions, (B, N, 3)."""
        return self.solver.positions.cpu().numpy()


class Newton:
    """Newton behind the same calls."""

    def __init__(self, scene: Scene, num_worlds: int, solver: str, substeps: int, iterations: int, device: str) -> None:
        from newton_peer import NewtonSolver

        method, _, rest = solver.removeprefix("Newton ").partition(" ")
        self.solver = NewtonSolver(
            scene.model,
            num_worlds,
            scene.held,
            method=method.lower(),
            substeps=substeps,
            iterations=iterations,
            bare="springs only" in rest,
            device=device,
        )
        self.targets = self.solver.targets.numpy().reshape(num_worlds, -1, 3).copy()

    def step(self, move: np.ndarray) -> None:
        """Move the held nodes by (B, 3) and advance one control step."""
        self.targets += move[:, None]
        self.solver.targets.assign(self.targets.reshape(-1, 3))
        self.solver.step()

    def wait(self) -> None:
        """Wait for the device."""
        import warp as wp

        wp.synchronize()

    def positions(self) -> np.ndarray:
        """Return node positions, (B, N, 3)."""
        return self.solver.positions


def now(device: str) -> float:
    """Return a time [s]: of the processor on CPU, where all solvers are sequential, so that other processes do not count."""
    return time.process_time() if device == "cpu" else time.perf_counter()


def make(scene: Scene, num_worlds: int, solver: str, substeps: int, iterations: int, device: str) -> Ours | Newton:
    """Return a solver by its name in the table."""
    if solver.startswith("Newton"):
        return Newton(scene, num_worlds, solver, substeps, iterations, device)
    return Ours(scene, num_worlds, substeps, device)


def largest_stretch(instance: Ours | Newton, model: Model, moves: np.ndarray, give_up: float = np.inf) -> float:
    """Return the largest elongation of any edge after any step; stop early once it exceeds `give_up`."""
    largest = 0.0
    for move in moves:
        instance.step(move)
        x = instance.positions()
        lengths = np.linalg.norm(x[:, model.edges[:, 0]] - x[:, model.edges[:, 1]], axis=-1)
        largest = max(largest, float(np.nan_to_num(lengths / model.rest_lengths - 1.0, nan=np.inf).max()))
        if largest > give_up:
            break
    return largest


def search(scene: Scene, solver: str, target: float, moves: np.ndarray, arguments: argparse.Namespace) -> Entry | None:
    """Return the cheapest setting of a Newton solver that stays below the target; None if there is none among those tried.

    For every number of iterations the fewest substeps are found by bisection.
    """
    start = now(arguments.device)
    method = solver.split()[1].lower()
    feasible = []
    for iterations in ITERATIONS[method]:
        candidates = [substeps for substeps in SUBSTEPS[method] if substeps * iterations <= MOST_SWEEPS]
        low, high, found = 0, len(candidates) - 1, None
        while low <= high and now(arguments.device) - start < PATIENCE:
            middle = (low + high) // 2
            instance = make(scene, moves.shape[1], solver, candidates[middle], iterations, arguments.device)
            stretch = largest_stretch(instance, scene.model, moves, target)
            if stretch <= target:
                found, high = Entry(scene, solver, candidates[middle], iterations, stretch), middle - 1
            else:
                low = middle + 1
        if found is not None:
            feasible.append(found)
    if not feasible:
        return None
    return min(feasible, key=lambda entry: seconds_per_step(entry, 4, arguments.device, 2))


def seconds_per_step(entry: Entry, num_worlds: int, device: str, num_steps: int) -> float:
    """Return the time of a control step after a warm-up."""
    instance = make(entry.scene, num_worlds, entry.solver, entry.substeps, entry.iterations, device)
    return timed(instance, motion(num_worlds, num_steps + 1), 0.0, device)


def timed(instance: Ours | Newton, moves: np.ndarray, seconds: float, device: str) -> float:
    """Return the seconds of one control step, over at least `seconds` and all moves but the first, which warms up."""
    instance.step(moves[0])
    instance.wait()
    steps, start = 0, now(device)
    while steps < len(moves) - 1 or now(device) - start < seconds:
        instance.step(moves[1 + steps % (len(moves) - 1)])
        steps += 1
    instance.wait()
    return (now(device) - start) / steps


def find_settings(scene: Scene, arguments: argparse.Namespace, methods: list[str]) -> list[Entry]:
    """Return ours and the Newton solvers of one scene, at equal stretch."""
    moves = motion(4, 20)
    substeps = scene.model.default_substeps
    target = arguments.target
    if target is None:
        reached = largest_stretch(make(scene, 4, "ours", substeps, 1, arguments.device), scene.model, moves)
        target = max(reached, SMALLEST_TARGET)
    else:
        candidates = (5, 8, 10, 15, 20, 30, 40, 60, 80, 120, 160, 240)
        solvers = ((n, make(scene, 4, "ours", n, 1, arguments.device)) for n in candidates)
        runs = ((n, largest_stretch(solver, scene.model, moves, target)) for n, solver in solvers)
        substeps, reached = next(((n, stretch) for n, stretch in runs if stretch <= target), (candidates[-1], np.nan))
    progress(f"{scene.name}: ours {substeps} substeps, largest stretch {reached:.4f}")
    entries = [Entry(scene, "ours", substeps, 1, reached)]
    for method in methods:
        entry = search(scene, method, target, moves, arguments)
        if entry is None:
            progress(f"{scene.name}: {method} reaches it with none of the settings tried")
            continue
        progress(f"{scene.name}: {method} {entry.substeps} x {entry.iterations}, largest stretch {entry.stretch:.4f}")
        entries.append(entry)
    return entries


def measure(entries: list[Entry], num_worlds: int, arguments: argparse.Namespace) -> None:
    """Let all solvers of a scene take turns at one number of worlds."""
    seconds, repeats = (0.1, 3) if arguments.quick else (0.3, 5)
    instances = {}
    for entry in entries:
        if seconds_per_step(entry, 1, arguments.device, 1) * num_worlds < SLOW:
            setting = (entry.solver, entry.substeps, entry.iterations, arguments.device)
            instances[entry.solver] = make(entry.scene, num_worlds, *setting)
    moves = motion(num_worlds, 2)
    for _ in range(repeats):
        for entry in entries:
            if entry.solver in instances:
                rate = num_worlds / timed(instances[entry.solver], moves, seconds, arguments.device)
                entry.rates.setdefault(num_worlds, []).append(rate)


def to_rows(entries: list[Entry], arguments: argparse.Namespace) -> list[dict]:
    """Return one row per solver and number of worlds; those of ours carry the ratio to the faster Newton solver."""
    rows = []
    for entry in entries:
        for num_worlds, rates in entry.rates.items():
            rate = statistics.median(rates)
            work = count_work(entry.scene.model, entry.solver, entry.substeps, entry.iterations)
            row = {
                "scene": entry.scene.name,
                "solver": entry.solver,
                "device": arguments.device,
                "num_worlds": num_worlds,
                "substeps": entry.substeps,
                "iterations": entry.iterations,
                "largest_stretch": entry.stretch,
                "env_steps_per_s": rate,
                "min": min(rates),
                "max": max(rates),
                "ns_per_projection": 1e9 / (rate * work.projections),
                **{f"work_{k}": v for k, v in asdict(work).items()},
                "gflop_per_s": rate * work.flops * 1e-9,
                "gbyte_per_s": rate * work.bytes * 1e-9,
            }
            if entry.solver.startswith("ours"):
                peers = [
                    statistics.median(other.rates[num_worlds])
                    for other in entries
                    if other.solver.startswith("Newton") and num_worlds in other.rates
                ]
                full = [
                    statistics.median(other.rates[num_worlds])
                    for other in entries
                    if other.solver in ("Newton XPBD", "Newton VBD") and num_worlds in other.rates
                ]
                row |= {"ratio": rate / max(full)} if full else {}
                row |= {"ratio_to_springs_only": rate / max(peers)} if len(peers) > len(full) else {}
            rows.append(row)
    return rows


def progress(line: str) -> None:
    """Print progress at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    """Parse the command line, search, measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="rope and 10x10 cloth, short: for a look rather than for the record")
    parser.add_argument("--scene", help='"rope 40", "cloth 10x10", "cloth 15x15" or "cloth 35x35" alone')
    parser.add_argument("--json", type=Path, help="file for the rows")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    parser.add_argument("--target", type=float, help="largest stretch that all solvers must reach, instead of ours by default")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    names = ["Newton XPBD", "Newton VBD", "Newton XPBD (springs only)", "Newton VBD (springs only)"]
    methods = names if find_spec("newton") else []
    worlds = [1, 64] if arguments.quick else [1, 64, 1024] + ([4096] if arguments.device == "cuda" else [])
    rows = []
    chosen = [scene for scene in scenes(arguments.quick) if arguments.scene in (None, scene.name)]
    if not chosen:
        parser.error(f"there is no scene {arguments.scene!r}")
    for scene in chosen:
        entries = find_settings(scene, arguments, methods if scene.model.num_nodes <= 100 else methods[:2])
        for num_worlds in worlds:
            measure(entries, num_worlds, arguments)
        known = len(rows)
        rows += to_rows(entries, arguments)
        # After every scene: an interrupted run keeps what it has.
        report(rows[known:], describe_machine(arguments.device))
        save(rows, describe_machine(arguments.device), arguments.json)
    peaks = {f"peak_{name}": value for name, value in measure_peaks().items()}
    save([*rows, peaks], describe_machine(arguments.device), arguments.json)


if __name__ == "__main__":
    main()
