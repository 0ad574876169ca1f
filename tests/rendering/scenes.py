"""Scenes for tests of the rasteriser, and independent answers to what is seen in them."""

import numpy as np
import torch
import warp as wp

from maniskill_grpd.rendering import Label, Lens, Rasterizer, TriangleScene, intrinsic_from_fov, look_at


def grid_faces(n):
    """Return the triangles of a square grid of n x n vertices, (F, 3)."""
    corner = (n * np.arange(n - 1)[:, None] + np.arange(n - 1)).ravel()
    return np.concatenate([corner[:, None] + [0, 1, n + 1], corner[:, None] + [0, n + 1, n]]).astype(np.int32)


def folded_cloths(num, n=16, side=0.3, seed=0):
    """Return vertices (num, n^2, 3) of wrinkled cloths, folded over by an angle that differs from one to the next."""
    rng = np.random.default_rng(seed)
    x, y = (value.ravel() for value in np.meshgrid(np.linspace(-side / 2, side / 2, n), np.linspace(-side / 2, side / 2, n)))
    cloths = []
    for _ in range(num):
        z = 0.02 * np.sin(25.0 * x + rng.uniform(0.0, 6.0)) * np.cos(17.0 * y + rng.uniform(0.0, 6.0))
        bend, crease = rng.uniform(0.0, np.pi), rng.uniform(-0.05, 0.05)
        beyond = np.maximum(x - crease, 0.0)
        cloths.append(np.stack([np.minimum(x, crease) + beyond * np.cos(bend), y, z + beyond * np.sin(bend) + 0.03], axis=1))
    return np.array(cloths, dtype=np.float32)


def scene_of(vertices, faces, label=Label.CLOTH, **colors):
    """Return a scene of the same triangles (F, 3) in worlds (B, V, 3)."""
    vertices = torch.as_tensor(np.asarray(vertices), dtype=torch.float32).contiguous()
    triangles = torch.as_tensor(np.asarray(faces), dtype=torch.int32)[None].contiguous()
    labels = torch.full(triangles.shape[:2], int(label), dtype=torch.int32)
    return TriangleScene(vertices, triangles, labels, torch.zeros(len(vertices), dtype=torch.int32), **colors)


def rasterizer(scene, size=64, eyes=((0.1, -0.4, 0.5),), targets=None, fov=0.9, near=0.01, far=10.0, **options):
    """Return a rasteriser of square images with one camera for each eye; they look at the origin by default."""
    eyes = torch.tensor(eyes)
    targets = torch.zeros_like(eyes) if targets is None else torch.tensor(targets)
    intrinsics = intrinsic_from_fov(fov, size, size).expand(len(eyes), 3, 3)
    return Rasterizer(scene, Lens(size, size, near, far), intrinsics, look_at(eyes, targets), **options)


def drawn(*arguments, **options):
    """Return a rasteriser that has drawn."""
    made = rasterizer(*arguments, **options)
    made.draw()
    return made


def pixel_rays(images, world, camera):
    """Return where a camera stands, (3,), and the directions of its pixels with unit depth, (H, W, 3)."""
    extrinsic = images.extrinsics[world, camera].numpy().astype(np.float64)
    intrinsic = images.intrinsics[camera].numpy().astype(np.float64)
    y, x = np.mgrid[: images.lens.height, : images.lens.width] + 0.5
    rays = np.stack([(x - intrinsic[0, 2]) / intrinsic[0, 0], (y - intrinsic[1, 2]) / intrinsic[1, 1], np.ones_like(x)], axis=-1)
    return -extrinsic[:, :3].T @ extrinsic[:, 3], rays @ extrinsic[:, :3]


@wp.kernel(enable_backward=False)
def cast_rays(
    mesh: wp.uint64, start: wp.vec3, rays: wp.array(dtype=wp.vec3), hits: wp.array(dtype=float), faces: wp.array(dtype=int)
):
    """Follow one ray; its length in units of its direction, infinity without a hit."""
    ray = wp.tid()
    length = wp.length(rays[ray])
    query = wp.mesh_query_ray(mesh, start, rays[ray] / length, 100.0)
    hits[ray] = wp.inf
    faces[ray] = -1
    if query.result:
        hits[ray] = query.t / length
        faces[ray] = query.face


def ray_cast(vertices, faces, start, rays):
    """Return depths (H, W) and triangles (H, W) by Warp's ray cast."""
    mesh = wp.Mesh(
        points=wp.array(np.asarray(vertices, np.float32), dtype=wp.vec3, device="cpu"),
        indices=wp.array(np.asarray(faces, np.int32).ravel(), dtype=int, device="cpu"),
    )
    shape = rays.shape[:2]
    hits = wp.zeros(rays[..., 0].size, dtype=float, device="cpu")
    found = wp.zeros(rays[..., 0].size, dtype=int, device="cpu")
    directions = wp.array(rays.reshape(-1, 3).astype(np.float32), dtype=wp.vec3, device="cpu")
    wp.launch(cast_rays, dim=len(directions), inputs=[mesh.id, wp.vec3(*start), directions, hits, found], device="cpu")
    return hits.numpy().reshape(shape), found.numpy().reshape(shape)


def first_hits(vertices, faces, start, rays):
    """Return the smallest multiple of each ray (k, 3) that meets a triangle, (k,), by a test of all triangles."""
    a, b, c = (np.asarray(vertices, np.float64)[faces[:, corner]] for corner in range(3))
    sides = np.cross(rays[:, None], (c - a)[None])
    determinants = (sides * (b - a)).sum(-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = (sides * (start - a)).sum(-1) / determinants
        turned = np.cross(start - a, b - a)
        v = (rays[:, None] * turned).sum(-1) / determinants
        t = ((c - a) * turned).sum(-1) / determinants
        inside = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 1e-9)
    return np.where(inside, t, np.inf).min(axis=1)
