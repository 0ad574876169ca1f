"""Meshes of the links of arms: those for collisions, and what they look like, with fewer triangles."""

from __future__ import annotations

import hashlib
import os
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from maniskill_grpd.agents.arms.urdf import Shape

NUM_FACES = 600
"""Triangles of a shape in pictures; its file has up to 20,000."""

Mesh = tuple[np.ndarray, np.ndarray]
"""Vertices (V, 3) [m] in the frame of a link, and triangles (F, 3), counter-clockwise as seen from outside."""


@cache
def shape_mesh(shape: Shape) -> Mesh:
    """Return a shape as it is."""
    if shape.file is None:
        mesh = trimesh.creation.box(shape.size)
        return _in_link(shape, mesh.vertices.view(np.ndarray), mesh.faces.view(np.ndarray))
    mesh = trimesh.load(shape.file, force="mesh")
    return _in_link(shape, mesh.vertices.view(np.ndarray) * shape.size, mesh.faces.view(np.ndarray))


@cache
def picture_mesh(shape: Shape) -> Mesh:
    """Return a shape with at most `NUM_FACES` triangles, which are computed once and kept in the user's cache."""
    if shape.file is None:
        return shape_mesh(shape)
    vertices, faces = _few_triangles(shape.file)
    return _in_link(shape, vertices * shape.size, faces)


def cache_folder() -> Path:
    """Return the folder of what can be computed again."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "maniskill_grpd"


def _few_triangles(file: Path) -> Mesh:
    kept = cache_folder() / f"{hashlib.sha256(file.read_bytes()).hexdigest()[:16]}_{NUM_FACES}.npz"
    if kept.is_file():
        with np.load(kept) as arrays:
            return arrays["vertices"], arrays["faces"]
    loaded = trimesh.load(file, force="mesh")
    mesh = trimesh.Trimesh(loaded.vertices, loaded.faces, process=True)  # without textures, whose seams cut it into pieces
    if len(mesh.faces) > NUM_FACES:
        mesh = mesh.simplify_quadric_decimation(face_count=NUM_FACES)
    found = mesh.vertices.view(np.ndarray), mesh.faces.view(np.ndarray)
    try:
        kept.parent.mkdir(parents=True, exist_ok=True)
        temporary = kept.with_suffix(f".{os.getpid()}.npz")
        np.savez(temporary, vertices=found[0], faces=found[1])
        temporary.replace(kept)
    except OSError:
        pass  # a home that cannot be written to costs some seconds in every process
    return found


def _in_link(shape: Shape, vertices: np.ndarray, faces: np.ndarray) -> Mesh:
    return vertices @ shape.origin[:3, :3].T + shape.origin[:3, 3], faces
