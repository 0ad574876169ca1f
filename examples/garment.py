"""Sew a shirt of two layers and drop it over a bar by its shoulders.

python examples/garment.py [--num_nodes 200] [--steps 80] [--png shirt.png]

Front and back are the same mesh, one thickness apart, and share the nodes of their seams: along the sides, under the sleeves and
over the shoulders. Hem, sleeves and neck stay open. Prints how many edges cross a triangle while the shirt falls and at rest.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
import trimesh
from mani_skill.sensors.camera import CameraConfig
from mani_skill.utils.sapien_utils import look_at
from PIL import Image

from maniskill_grpd.physics import Model, Solver, capsule, cloth, cloth_from_mesh
from maniskill_grpd.physics.crossings import count_crossings
from maniskill_grpd.tasks.pictures.drawing import Drawing, Sheet, Solid
from maniskill_grpd.tasks.pictures.warp_painter import WarpPainter

RIGHT = [(0.12, 0.0), (0.12, 0.24), (0.22, 0.21), (0.25, 0.31), (0.06, 0.38)]
OUTLINE = np.array([*RIGHT, (0.0, 0.34), *((-x, y) for x, y in RIGHT[::-1])])
"""Counter-clockwise from the right end of the hem [m]."""
SEAMS = (0, 1, 3, 6, 8, 9)
"""Sides of the outline, by their first corner, that are sewn: side, under the sleeve, shoulder, and the same on the left."""
BAR_RADIUS, BAR_HALF_LENGTH, BAR_HEIGHT, BAR_Y = 0.015, 0.3, 0.4, 0.24


def sew_shirt(num_nodes: int) -> Model:
    """Return a shirt with about `num_nodes` nodes in each layer, which lies flat."""
    panel = cloth(OUTLINE, num_nodes=num_nodes)
    layer = panel.rest_positions.astype(np.float64)
    seam = np.concatenate([panel.node_sets[f"edge_{side}"] for side in SEAMS])
    rise = np.full(len(layer), 1.1 * panel.radius)
    rise[seam] = 0.0  # nodes at the same place are one: there the layers are sewn together
    up = np.array([0.0, 0.0, 1.0])
    vertices = np.concatenate([layer + rise[:, None] * up, layer - rise[:, None] * up])
    faces = np.concatenate([panel.faces, panel.faces[:, ::-1] + len(layer)])
    return cloth_from_mesh(vertices, faces, radius=panel.radius)


def draw(solver: Solver, bar: trimesh.Trimesh, path: Path) -> None:
    """Save a picture of the first world."""
    camera = CameraConfig("camera", look_at([0.55, -0.65, 0.7], [0.0, 0.0, 0.3]), 640, 640, 0.8, 0.01, 10.0)
    painter = WarpPainter(camera)
    shirt = Sheet(solver.positions[0].double().numpy(), solver.model.faces)
    nothing = {"grippers": np.zeros((0, 3)), "closed": np.zeros(0, dtype=bool), "is_solved": False}
    painter.show(Drawing(object=shirt, solids=(Solid(bar.vertices, bar.faces),), **nothing))
    Image.fromarray(painter.picture()[0].numpy()).save(path)


def main() -> None:
    """Drop the shirt."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--num_nodes", type=int, default=200, help="nodes in each layer, about")
    parser.add_argument("--steps", type=int, default=80, help="control steps of 0.05 s")
    parser.add_argument("--png", type=Path, help="where to save a picture")
    arguments = parser.parse_args()
    solver = Solver(sew_shirt(arguments.num_nodes), 1, 1, colliders=[capsule(BAR_RADIUS, BAR_HALF_LENGTH)], self_collision=True)
    solver.positions += torch.tensor([0.0, -BAR_Y, BAR_HEIGHT + 0.03])
    solver.collider_positions[:, 0] = torch.tensor([0.0, 0.0, BAR_HEIGHT])
    solver.collider_rotations[:, 0] = torch.tensor([0.5**0.5, 0.0, 0.5**0.5, 0.0])  # along x
    most = crossings = 0
    for _ in range(arguments.steps):
        solver.step()
        crossings = int(count_crossings(solver.model, solver.positions)[0])
        most = max(most, crossings)
    dropped, lowest = int(solver.dropped_contacts[0]), float(solver.positions[0, :, 2].min())
    print(
        f"{solver.num_nodes} nodes, lowest at {lowest:.3f} m; crossings: at most {most}, at rest {crossings}; dropped: {dropped}"
    )
    if arguments.png:
        bar = trimesh.creation.capsule(
            2.0 * BAR_HALF_LENGTH, BAR_RADIUS, transform=trimesh.transformations.rotation_matrix(np.pi / 2, [0.0, 1.0, 0.0])
        )
        bar.apply_translation([0.0, 0.0, BAR_HEIGHT] - bar.centroid)
        draw(solver, bar, arguments.png)


if __name__ == "__main__":
    main()
