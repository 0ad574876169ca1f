"""Run motion-capture recordings of five real cables through the solver, and print how far the simulated ones are off.

python benchmarks/real_rope.py --data FOLDER [--json FILE]

The recordings are those of DEFORM (Chen et al. 2024, "Differentiable Discrete Elastic Rods for Real-Time Modeling of Deformable
Linear Objects", https://github.com/roahmlab/DEFORM, folder `data_set`, at commit b73b8b8). They have no licence file, so they are
not part of this repository: clone theirs and pass the folder that holds DLO1 ... DLO5. Each has 12 or 13 markers, 100 frames per
second, 5 s; two robots hold a cable by its first and its last two markers, which are four grippers here.

Two numbers of each cable are fitted on its training part: bending stiffness over density EI / rho [m^4/s^2] and drag [1/s]. A
cable has a node at each marker, is straight at rest, and starts from its first two frames; nothing is corrected later on.
"""

from __future__ import annotations

import argparse
import json
import pickle
import sys
from pathlib import Path
from typing import Any

import numpy as np
import torch

from maniskill_grpd.physics import RopeMaterial, Solver, rope
from maniskill_grpd.physics.leashes import NO_LEASH

CABLES = ("DLO1", "DLO2", "DLO3", "DLO4", "DLO5")
FRAME_TIME = 0.01
"""Time from frame to frame [s]."""
SUBSTEPS = 10
"""Substeps of a frame."""
DENSITY = 0.05
"""Mass per length [kg/m]; only EI / rho matters where grippers are kinematic."""
STIFFNESSES = np.geomspace(1e-3, 0.5, 10)
"""Bending stiffnesses over density that are tried first [m^4/s^2]."""
DRAGS = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 4.0])
"""Drags that are tried first [1/s]."""


class ArraysOnly(pickle.Unpickler):
    """Reads pickled arrays, and refuses to run anything else."""

    def find_class(self, module: str, name: str) -> Any:
        """Return what numpy pickles arrays with."""
        if module.split(".")[0] == "numpy" and name in ("_reconstruct", "ndarray", "dtype"):
            return super().find_class(module, name)
        raise pickle.UnpicklingError(f"a recording is an array, but this file wants {module}.{name}")


def load_recordings(folder: Path, cable: str, part: str) -> torch.Tensor:
    """Return the recordings (R, T, N, 3) [m] of a part, "train" or "eval".

    Raises:
        FileNotFoundError: If there are none; says where they come from.
    """
    files = sorted((folder / cable / part).glob("*.pkl"))
    if not files:
        raise FileNotFoundError(
            f"no recordings {folder / cable / part}/*.pkl; clone https://github.com/roahmlab/DEFORM and pass its folder data_set"
        )
    recordings = []
    for path in files:
        with path.open("rb") as file:
            recordings.append(np.asarray(ArraysOnly(file).load(), dtype=np.float64).transpose(0, 2, 1))
    return torch.as_tensor(np.stack(recordings), dtype=torch.float32)


def mean_segments(recordings: torch.Tensor) -> np.ndarray:
    """Return the mean distances of neighbouring markers, (N - 1,) [m]."""
    return recordings.double().diff(dim=2).norm(dim=-1).mean(dim=(0, 1)).numpy()


def simulate(recordings: torch.Tensor, segments: np.ndarray, stiffness: float, drag: float) -> torch.Tensor:
    """Replay recordings (R, T, N, 3) with a cable of given EI / rho [m^4/s^2] and drag [1/s]; returns its markers, of that shape.

    The first two frames are those of the recordings.
    """
    num, num_frames, num_markers, _ = recordings.shape
    places = np.concatenate([[0.0], np.cumsum(segments)])
    material = RopeMaterial(linear_density=DENSITY, bend_stiffness=stiffness * DENSITY, damping=drag)
    model = rope(np.column_stack([places, np.zeros_like(places)]), num_nodes=None, material=material)
    solver = Solver(model, num, 4, control_dt=FRAME_TIME, substeps=SUBSTEPS)
    solver.plane[:, 3] = -10.0
    held = [0, 1, num_markers - 2, num_markers - 1]
    solver.reset(torch.arange(num), recordings[:, 1], torch.tensor(held))
    solver.leashes[:] = NO_LEASH  # markers are where they were seen, to the millimetre
    solver.velocities.copy_((recordings[:, 1] - recordings[:, 0]) / FRAME_TIME)
    frames = [recordings[:, 0], recordings[:, 1]]
    for frame in range(2, num_frames):
        solver.gripper_targets.copy_(recordings[:, frame, held])
        solver.step()
        frames.append(solver.positions.clone())
    return torch.stack(frames, dim=1)


def mean_error(recordings: torch.Tensor, segments: np.ndarray, stiffness: float, drag: float) -> float:
    """Return the mean distance of the free markers from where they were seen [m]."""
    simulated = simulate(recordings, segments, stiffness, drag)
    return (simulated - recordings)[:, 2:, 2:-2].norm(dim=-1).mean().item()


def fit(recordings: torch.Tensor, segments: np.ndarray, rounds: int = 3) -> tuple[float, float]:
    """Return the stiffness EI / rho [m^4/s^2] and the drag [1/s] with the smallest error, each searched in turn."""
    stiffness, drag = 0.02, 0.5
    factors, offsets = STIFFNESSES / stiffness, DRAGS - drag
    for _ in range(rounds):
        candidates = [stiffness * factor for factor in factors]
        stiffness = min(candidates, key=lambda value: mean_error(recordings, segments, value, drag))
        candidates = sorted({max(drag + offset, 0.0) for offset in offsets})
        drag = min(candidates, key=lambda value: mean_error(recordings, segments, stiffness, value))
        width = np.log(factors[-1] / factors[0]) / (len(factors) - 1)
        factors = np.exp(np.linspace(-width, width, 7))
        offsets = np.linspace(-0.5, 0.5, 5) * (offsets[-1] - offsets[0]) / 4.0
    return float(stiffness), float(drag)


def measure(folder: Path, cable: str) -> dict[str, Any]:
    """Fit a cable on its training part and measure it on the other."""
    training, unseen = load_recordings(folder, cable, "train"), load_recordings(folder, cable, "eval")
    segments = mean_segments(training)
    stiffness, drag = fit(training, segments)
    moved = (unseen - unseen[:, 1:2])[:, 2:, 2:-2].norm(dim=-1).mean().item()
    return {
        "cable": cable,
        "recordings": [len(training), len(unseen)],
        "stiffness": stiffness,
        "drag": drag,
        "error": mean_error(unseen, segments, stiffness, drag),
        "error_without_bending": mean_error(unseen, segments, 0.0, drag),
        "error_on_training": mean_error(training, segments, stiffness, drag),
        "moved": moved,
    }


def main() -> None:
    """Print a table of all cables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True, help="folder that holds DLO1 ... DLO5")
    parser.add_argument("--json", type=Path, help="also write the results to this file")
    arguments = parser.parse_args()
    rows = []
    print("| cable | EI / rho [m^4/s^2] | drag [1/s] | mean error [mm] | without bending [mm] | markers move by [mm] |")
    print("|---|--:|--:|--:|--:|--:|")
    for cable in CABLES:
        try:
            row = measure(arguments.data, cable)
        except FileNotFoundError as missing:
            sys.exit(str(missing))
        millimetres = [f"{1e3 * row[key]:.0f}" for key in ("error", "error_without_bending", "moved")]
        print(f"| {cable} | {row['stiffness']:.3g} | {row['drag']:.2g} | {' | '.join(millimetres)} |", flush=True)
        rows.append(row)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
