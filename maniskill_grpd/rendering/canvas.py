"""Pictures of smoothly shaded triangles: shadows on a table, outlines, translucent layers, soft edges; in Warp, on the CPU.

Work is done only in the tiles of a picture on which something is drawn: the ground of all pictures is drawn once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import warp as wp

from maniskill_grpd.physics.launches import quiet_warp
from maniskill_grpd.physics.memory import check_memory
from maniskill_grpd.rendering import palette
from maniskill_grpd.rendering.cameras import Lens
from maniskill_grpd.rendering.kernels import canvas as kernels

SAMPLES = 2
"""Samples per pixel and direction: edges get soft."""
AMBIENT, DIRECT, FILL, GLOSS = 0.44, 0.46, 0.18, 0.16
"""Shares of the light from everywhere, from the lamp and from the camera; strength of the lamp's reflections."""
GLOSS_EXPONENT = 24.0
EDGE_STEP = 0.0022
"""Steps of the nearness [1/m] that are drawn as edges: 4 mm at a distance of 1.3 m."""
EDGE_DARKNESS = 0.35
EDGE_MARGIN = 1.0
"""How far beyond what is drawn edges may lie [samples]."""
DEVICE = "cpu"
NUM_LAYERS, BYTES_PER_SAMPLE = 3, 16


@dataclass(frozen=True)
class ShadedMesh:
    """Triangles with smooth normals and the colours of their two sides."""

    vertices: np.ndarray
    """(n, 3) [m]."""
    normals: np.ndarray
    """Unit normals of the front at the vertices, (n, 3)."""
    faces: np.ndarray
    """(F, 3), counter-clockwise as seen from the front."""
    fronts: np.ndarray
    """sRGB in [0, 1], (F, 3)."""
    backs: np.ndarray
    """(F, 3)."""


@dataclass(frozen=True)
class ShadedTriangles:
    """A mesh as a canvas sees and lights it."""

    places: wp.array
    """Where the corners appear, x right and y down [samples], and their nearness, (F, 3)."""
    colors: wp.array
    """Colours of the corners, (F, 3)."""


class Canvas:
    """A picture of a pinhole camera that looks along the x-axis of its pose, y left and z up.

    `wipe` goes back to the ground; `cast_shadows`, `paint`, `draw_edges` and `glaze` then draw over it, in that order.
    """

    def __init__(self, lens: Lens, fov: float, pose: np.ndarray) -> None:
        """Allocate the picture; nothing is on it.

        Args:
            lens: Size of the picture; what is nearer than `near` is not seen.
            fov: Vertical field of view [rad].
            pose: Of the camera in the world, (4, 4) [m].

        Raises:
            ValueError: If memory does not suffice, with what the picture needs.
        """
        num_bytes = NUM_LAYERS * BYTES_PER_SAMPLE * SAMPLES**2 * lens.width * lens.height
        check_memory(f"pictures of {lens.width}x{lens.height} pixels", num_bytes, "their samples", torch.device(DEVICE))
        self._eye = _eye(lens, fov, pose)
        self._layer, self._film, self._ground = (_layer(lens) for _ in range(NUM_LAYERS))
        self._shadow = wp.zeros((lens.height, lens.width), dtype=wp.uint8, device=DEVICE)
        self._wiped = wp.zeros_like(self._layer.tiles)
        self._picture = wp.zeros((lens.height, lens.width, 3), dtype=wp.uint8, device=DEVICE)

    @property
    def nearness(self) -> np.ndarray:
        """Inverse depth of what the samples show, (2 H, 2 W) float32 [1/m]; 0 for nothing. A view."""
        return self._layer.nearness.numpy()

    @property
    def colors(self) -> np.ndarray:
        """Colours of the samples, (2 H, 2 W, 3) float32 in [0, 1]. A view."""
        return self._layer.colors.numpy()

    def set_ground(self, background: palette.Color, meshes: list[ShadedMesh]) -> None:
        """Set what is below everything: a background, and unlit meshes that cast no shadows; wipes."""
        ground = self._ground
        ground.colors.fill_(wp.vec3(*background))
        ground.nearness.zero_()
        for mesh in meshes:
            self._paint(self.shade(mesh, is_lit=False), ground)
        self._layer.tiles.fill_(1)
        self.wipe()

    def wipe(self) -> None:
        """Go back to the ground."""
        self._per_tile(kernels.wipe, [SAMPLES, self._ground, self._shadow, self._layer])
        self._per_tile(kernels.clear_tiles, [self._wiped, self._layer])

    def cast_shadows(self, mesh: ShadedMesh, *, half_size: float, height: float) -> None:
        """Darken a square table at z = 0, of half a side [m], where a mesh keeps the light off; shadows lie `height` above it."""
        places = wp.empty((len(mesh.faces), 3), dtype=wp.vec3, device=DEVICE)
        _launch(kernels.cast, len(mesh.faces), [_described(mesh), self._eye, half_size, height, places])
        _launch(kernels.paint_shadow, 1, [places, SAMPLES, self._shadow, self._layer])
        self._per_tile(kernels.darken, [SAMPLES, palette.SHADOW_DARKNESS, self._shadow, self._layer])

    def shade(self, mesh: ShadedMesh, *, is_lit: bool = True) -> ShadedTriangles:
        """Return what the camera sees of a mesh; unlit it has its colours."""
        shape = (len(mesh.faces), 3)
        places, colors = (wp.empty(shape, dtype=wp.vec3, device=DEVICE) for _ in range(2))
        _launch(kernels.shade, shape[0], [_described(mesh), self._eye, is_lit, places, colors])
        return ShadedTriangles(places, colors)

    def paint(self, triangles: ShadedTriangles) -> None:
        """Draw opaque triangles where they are the nearest."""
        self._paint(triangles, self._layer)

    def draw_edges(self) -> None:
        """Darken what lies just behind the edge of something nearer."""
        self._per_tile(kernels.draw_edges, [EDGE_STEP, EDGE_DARKNESS, self._layer])

    def glaze(self, triangles: ShadedTriangles, *, alpha: float, hidden_alpha: float = 0.0, lead: float = 0.0) -> None:
        """Draw the foremost layer of triangles translucently; what lies behind it still counts as the nearest.

        Args:
            triangles: What to draw.
            alpha: Its opacity in [0, 1].
            hidden_alpha: Its opacity where something is in front of it.
            lead: What is not the ground counts as in front up to this far behind the layer [m].
        """
        self._paint(triangles, self._film)
        self._per_tile(kernels.glaze, [alpha, hidden_alpha, lead, self._ground.nearness, self._film, self._layer])

    def picture(self) -> np.ndarray:
        """Return what was drawn, (H, W, 3) uint8."""
        self._per_tile(kernels.resolve, [SAMPLES, self._wiped, self._layer, self._picture])
        return self._picture.numpy().copy()

    def _paint(self, triangles: ShadedTriangles, layer: kernels.Layer) -> None:
        _launch(kernels.paint, 1, [triangles.places, triangles.colors, EDGE_MARGIN, layer])

    def _per_tile(self, kernel: wp.Kernel, inputs: list) -> None:
        _launch(kernel, self._layer.tiles.shape, inputs)


def _layer(lens: Lens) -> kernels.Layer:
    layer = kernels.Layer()
    layer.height, layer.width = SAMPLES * lens.height, SAMPLES * lens.width
    tiles = tuple(-(-side // int(kernels.TILE)) for side in (layer.height, layer.width))
    layer.nearness = wp.zeros((layer.height, layer.width), dtype=float, device=DEVICE)
    layer.colors = wp.zeros((layer.height, layer.width), dtype=wp.vec3, device=DEVICE)
    layer.tiles = wp.zeros(tiles, dtype=wp.uint8, device=DEVICE)
    return layer


def _eye(lens: Lens, fov: float, pose: np.ndarray) -> kernels.Eye:
    eye, position = kernels.Eye(), pose[:3, 3]
    view = position / np.linalg.norm(position)
    half = palette.LIGHT_DIRECTION + view
    eye.axes, eye.position = wp.mat33(*pose[:3, :3].T.ravel().tolist()), wp.vec3(*position.tolist())
    eye.focal = SAMPLES * lens.height / 2.0 / np.tan(fov / 2.0)
    eye.center = wp.vec2(SAMPLES * lens.width / 2.0, SAMPLES * lens.height / 2.0)
    eye.nearest = lens.near
    eye.lamp, eye.view = wp.vec3(*palette.LIGHT_DIRECTION), wp.vec3(*view.tolist())
    eye.glossy = wp.vec3(*(half / np.linalg.norm(half)).tolist())
    eye.shares = wp.vec3(AMBIENT, DIRECT, FILL)
    eye.gloss, eye.gloss_exponent = GLOSS, GLOSS_EXPONENT
    return eye


def _described(mesh: ShadedMesh) -> kernels.Mesh:
    """Return a mesh as kernels take it."""
    described = kernels.Mesh()
    for name in ("vertices", "normals", "fronts", "backs"):
        values = np.ascontiguousarray(getattr(mesh, name), dtype=np.float32)
        setattr(described, name, wp.array(values, dtype=wp.vec3, device=DEVICE, copy=False))
    faces = np.ascontiguousarray(mesh.faces, dtype=np.int32)
    described.faces = wp.array(faces, dtype=wp.vec3i, device=DEVICE, copy=False)
    return described


def _launch(kernel: wp.Kernel, dim: int | tuple[int, int], inputs: list) -> None:
    with quiet_warp():
        wp.init()
        wp.launch(kernel, dim=dim, inputs=inputs, device=DEVICE)
