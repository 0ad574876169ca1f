"""Measure images of depth per second beside Warp's ray cast, and how they agree, in one run.

python benchmarks/cameras.py [--quick] [--json FILE]

Wrinkled square cloths, one camera 45 cm above each, which fill a quarter of the image; one thread. Both look at the same meshes.
The ray cast follows one ray per pixel through a bounding volume hierarchy of all worlds, far apart from each other; updating it
counts, as cloth moves between images. Both take turns, and the time is that of the thread's own processor, which does not count
waiting for a core. At the end environment steps of ClothFolding-v1 by what is observed, also with images by SAPIEN where it can
draw, and pictures of 512x512 pixels of all tasks (`render_mode="rgb_array"`).
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
import warp as wp
from machine import describe_machine, report

import maniskill_grpd  # noqa: F401  (registers the tasks)
from maniskill_grpd.rendering import Label, Lens, Rasterizer, TriangleScene, look_at
from maniskill_grpd.tasks.pictures.render_device import can_draw

SIDE, EYE_HEIGHT, FOCAL = 0.24, wp.constant(0.45), 0.9
"""Side of the cloths and height of the cameras [m], and focal length in widths of the image."""
APART = 50.0
"""Distance of the worlds for the ray cast [m]."""
NUM_STEPS = 40
"""Steps of an environment in one repeat."""
NUM_PICTURES = 20
"""Pictures in one repeat."""
TASKS = ("RopeShaping-v1", "RopeWrapping-v1", "ClothFolding-v1", "ClothHanging-v1")


@wp.kernel(enable_backward=False)
def cast_rays(mesh: wp.uint64, offsets: wp.array(dtype=wp.vec3), focal: float, depth: wp.array3d(dtype=float)):
    """Follow the ray of one pixel straight down to the cloth of its world."""
    world, y, x = wp.tid()
    half = float(depth.shape[1]) * 0.5
    ray = wp.normalize(wp.vec3((float(x) + 0.5 - half) / focal, -(float(y) + 0.5 - half) / focal, -1.0))
    query = wp.mesh_query_ray(mesh, offsets[world] + wp.vec3(0.0, 0.0, EYE_HEIGHT), ray, 10.0)
    depth[world, y, x] = wp.inf
    if query.result:
        depth[world, y, x] = -query.t * ray[2]


def wrinkled_cloths(num_worlds: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices (B, n^2, 3) [m] and triangles (F, 3)."""
    line = np.linspace(-SIDE / 2, SIDE / 2, n)
    x, y = (value.ravel() for value in np.meshgrid(line, line))
    phase = np.random.default_rng(0).uniform(0.0, 6.0, (num_worlds, 1))
    z = 0.03 * np.sin(20.0 * x + phase)
    corner = (n * np.arange(n - 1)[:, None] + np.arange(n - 1)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, n + 1], corner[:, None] + [0, n + 1, n]])
    return np.stack(np.broadcast_arrays(x, y, z), axis=-1).astype(np.float32), faces.astype(np.int32)


def rasterized(vertices: np.ndarray, faces: np.ndarray, size: int) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """Return what draws all worlds with the rasteriser, and what reads the depth (B, H, W)."""
    triangles = torch.as_tensor(faces)[None]
    labels = torch.full(triangles.shape[:2], int(Label.CLOTH), dtype=torch.int32)
    scene = TriangleScene(torch.as_tensor(vertices), triangles, labels, torch.zeros(len(vertices), dtype=torch.int32))
    focal = FOCAL * size
    intrinsics = torch.tensor([[[focal, 0.0, size / 2], [0.0, focal, size / 2], [0.0, 0.0, 1.0]]])
    extrinsics = look_at(torch.tensor([[0.0, 0.0, EYE_HEIGHT]]), torch.zeros(1, 3))
    images = Rasterizer(scene, Lens(size, size), intrinsics, extrinsics, num_threads=1)
    return images.draw, lambda: images.depth()[:, 0].numpy()


def ray_cast(vertices: np.ndarray, faces: np.ndarray, size: int) -> tuple[Callable[[], None], Callable[[], np.ndarray]]:
    """Return what draws all worlds with Warp's ray cast, and what reads the depth (B, H, W)."""
    num = len(vertices)
    offsets = APART * np.stack([np.arange(num) % 32, np.arange(num) // 32, np.zeros(num)], axis=1)
    points = (vertices + offsets[:, None]).reshape(-1, 3).astype(np.float32)
    indices = (faces + vertices.shape[1] * np.arange(num)[:, None, None]).astype(np.int32).ravel()
    mesh = wp.Mesh(points=wp.array(points, dtype=wp.vec3, device="cpu"), indices=wp.array(indices, dtype=wp.int32, device="cpu"))
    depth = wp.zeros((num, size, size), dtype=float, device="cpu")
    places = wp.array(offsets.astype(np.float32), dtype=wp.vec3, device="cpu")

    def draw() -> None:
        mesh.refit()
        wp.launch(cast_rays, dim=depth.shape, inputs=[mesh.id, places, FOCAL * size, depth], device="cpu")

    return draw, depth.numpy


def measure(num_worlds: int, n: int, size: int, repeats: int) -> list[dict[str, Any]]:
    """Return a row for each of the two, with the ratio to the ray cast."""
    scene = wrinkled_cloths(num_worlds, n)
    subjects = {"rasteriser": rasterized(*scene, size), "Warp ray cast": ray_cast(*scene, size)}
    times: dict[str, list[float]] = {name: [] for name in subjects}
    for _ in range(repeats + 1):  # the first compiles and touches memory
        for name, (draw, _) in subjects.items():
            start = time.thread_time()
            draw()
            times[name].append(time.thread_time() - start)
    ours, theirs = (read() for _, read in subjects.values())
    both = np.isfinite(ours) & np.isfinite(theirs)
    agreement = {
        "median_depth_error": float(np.median(np.abs(ours[both] - theirs[both]))),
        "share_within_0.1_mm": float((np.abs(ours[both] - theirs[both]) < 1e-4).mean()),
        "share_of_mask_that_differs": float((np.isfinite(ours) != np.isfinite(theirs)).mean()),
    }
    ratios = [theirs / ours for ours, theirs in zip(*(spent[1:] for spent in times.values()), strict=True)]
    rows = []
    for name, spent in times.items():
        row = {"renderer": name, "nodes": n * n, "size": size, "num_worlds": num_worlds}
        rows.append(row | {"images_per_s": num_worlds / statistics.median(spent[1:])})
    rows[0] |= {"ratio": statistics.median(ratios)} | agreement
    return rows


def observations() -> dict[str, dict[str, Any]]:
    """Return what is compared, options of the environment by name."""
    images = {"obs_mode": "depth", "sensor_configs": {"width": 64, "height": 64}}
    cases = {
        "graph": {},
        "graph, nodes that a camera sees": {"visibility": "camera"},
        "graph, 8 keypoints": {"keypoints": 8},
        "depth": images,
    }
    return {**cases, "depth by SAPIEN": {**images, "render_backend": "cpu"}} if can_draw("cpu") else cases


def measure_environment(name: str, options: dict[str, Any], num_worlds: int, repeats: int) -> dict[str, Any]:
    """Return environment steps per second of ClothFolding-v1 in processor time of all threads."""
    env = gym.make("ClothFolding-v1", num_envs=num_worlds, sim_backend="cpu", **options)
    env.reset(seed=0)
    action = torch.zeros(num_worlds, env.action_space.shape[-1])
    rates = []
    for _ in range(repeats):
        start = time.process_time()
        for _ in range(NUM_STEPS):
            env.step(action)
        rates.append(num_worlds * NUM_STEPS / (time.process_time() - start))
    env.close()
    return {"env": "ClothFolding-v1", "obs_mode": name, "num_worlds": num_worlds, "env_steps_per_s": statistics.median(rates)}


def measure_pictures(env_id: str, repeats: int) -> dict[str, Any]:
    """Return milliseconds of processor time for a picture of 512x512 pixels, without SAPIEN."""
    env = gym.make(env_id, render_mode="rgb_array", render_backend="warp", sim_backend="cpu")
    env.reset(seed=0)
    env.render()  # compiles, and draws what never moves
    times = []
    for _ in range(NUM_PICTURES * repeats):
        env.step(torch.zeros(1, env.action_space.shape[-1]))
        start = time.thread_time()
        env.render()
        times.append(time.thread_time() - start)
    env.close()
    return {"picture_of": env_id, "milliseconds": 1e3 * statistics.median(times)}


def main() -> None:
    """Measure, print and save."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="one small case")
    parser.add_argument("--json", type=Path, help="where to write the rows")
    options = parser.parse_args()
    torch.set_num_threads(1)
    machine = describe_machine()
    worlds, nodes, sizes, repeats = ((8,), (10,), (64,), 1) if options.quick else ((64, 1024), (10, 32), (64, 128), 3)
    rows = [row for b in worlds for n in nodes for size in sizes for row in measure(b, n, size, repeats)]
    rows += [measure_environment(name, case, worlds[0], repeats) for name, case in observations().items()]
    rows += [measure_pictures(env_id, repeats) for env_id in TASKS]
    report(rows, machine, options.json)


if __name__ == "__main__":
    main()
