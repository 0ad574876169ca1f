"""Measure how the cost of a control step grows with nodes and with worlds, and plot it.

python benchmarks/physics_scaling.py [--quick] [--out docs/benchmarks]

Cost per control step at a fixed number of substeps, on CPU in time of the processor. Slope 1 in the doubly logarithmic plot is
linear growth. Up to 16 worlds of a kind are advanced together, so that fewer cost as much.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import torch
from machine import describe_machine

from maniskill_grpd.physics import Model, Solver, cloth, rope, square_outline

SUBSTEPS = 20


def seconds_per_step(model: Model, num_worlds: int, self_collision: bool, device: str, seconds: float, repeats: int) -> float:
    """Return the median time [s] of one control step of dragged worlds on one thread."""
    solver = Solver(model, num_worlds, 2, substeps=SUBSTEPS, device=device, num_threads=1, self_collision=self_collision)
    solver.plane[:, 3] = -10.0
    held = torch.tensor([0, model.num_nodes - 1], device=device)
    start = torch.as_tensor(model.rest_positions, device=device).expand(num_worlds, -1, -1).contiguous()
    solver.reset(torch.arange(num_worlds, device=device), start, held)
    now = time.process_time if device == "cpu" else time.perf_counter
    times = []
    for _ in range(repeats + 1):
        steps, begin = 0, now()
        while steps == 0 or now() - begin < seconds:
            solver.gripper_targets.copy_(solver.gripper_positions)
            solver.gripper_targets[..., 0] += 0.01 * (-1) ** steps
            solver.step()
            if device == "cuda":
                torch.cuda.synchronize()
            steps += 1
        times.append((now() - begin) / steps)
    return statistics.median(times[1:])  # the first repeat warms up


def slope(x: list[float], y: list[float]) -> float:
    """Return the exponent of growth between the two largest sizes and the middle of the range."""
    half = len(x) // 2
    return float(np.polyfit(np.log(x[half:]), np.log(y[half:]), 1)[0])


def measure(quick: bool, device: str) -> list[dict]:
    """Return one row per curve with sizes, seconds and the exponent."""
    seconds, repeats = (0.1, 2) if quick else (0.5, 5)
    line = [[-0.4, 0.0, 0.0], [0.4, 0.0, 0.0]]
    cloths = [(n, cloth(square_outline(0.4), num_nodes=n), 16) for n in (49, 100, 225, 441, 784, 1225)]
    curves = {
        "rope, 16 worlds": ("nodes", [(n, rope(line, num_nodes=n), 16) for n in (20, 40, 80, 160, 320, 640)]),
        "cloth, 16 worlds": ("nodes", cloths),
        "cloth in contact with itself, 16 worlds": ("nodes", cloths),
    }
    for name, model in (("rope of 40 nodes", rope(line, num_nodes=40)), ("cloth of 100 nodes", cloth(square_outline(0.4)))):
        curves[name] = ("worlds", [(b, model, b) for b in (1, 4, 16, 64, 256, 1024)])
    rows = []
    for name, (axis, points) in curves.items():
        sizes = [size for size, _, _ in points]
        touches = "itself" in name
        times = [seconds_per_step(model, worlds, touches, device, seconds, repeats) for _, model, worlds in points]
        rows.append({"curve": name, "axis": axis, "sizes": sizes, "seconds": times, "exponent": slope(sizes, times)})
        sys.stdout.write(f"{name}: time ~ {axis}^{rows[-1]['exponent']:.2f}\n")
    return rows


def plot(rows: list[dict], path: Path) -> None:
    """Plot time over size, beside lines of slope 1."""
    figure, axes = plt.subplots(1, 2, figsize=(8, 3.6))
    for axis, kind in zip(axes, ("nodes", "worlds"), strict=True):
        for row in [row for row in rows if row["axis"] == kind]:
            axis.loglog(row["sizes"], row["seconds"], "o-", ms=4, label=f"{row['curve']}: exponent {row['exponent']:.2f}")
            linear = np.array(row["sizes"]) / row["sizes"][-1] * row["seconds"][-1]
            axis.loglog(row["sizes"], linear, "k:", lw=0.8)
        axis.set(xlabel=kind, ylabel="seconds per control step")
        axis.set_ylim(top=20.0 * axis.get_ylim()[1])
        axis.legend(fontsize=8, loc="upper left")
    figure.suptitle(f"Cost of a control step of {SUBSTEPS} substeps, one thread (dotted: linear)", fontsize=10)
    figure.tight_layout()
    figure.savefig(path, dpi=120)


def main() -> None:
    """Measure, write and plot."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="short measurements")
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks"), help="folder for physics_scaling.json and .png")
    parser.add_argument("--device", default="cpu", help="cpu or cuda")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = measure(arguments.quick, arguments.device)
    machine = describe_machine(arguments.device)
    text = json.dumps([{**row, "machine": machine} for row in rows], indent=1)
    (arguments.out / "physics_scaling.json").write_text(text + "\n")
    plot(rows, arguments.out / "physics_scaling.png")


if __name__ == "__main__":
    main()
