"""Batched images of triangles, on CPU and CUDA from one source."""

from __future__ import annotations

import torch
import warp as wp

from maniskill_grpd.physics.launches import Launches, choose_num_threads, quiet_warp
from maniskill_grpd.rendering import palette
from maniskill_grpd.rendering.cameras import Lens
from maniskill_grpd.rendering.kernels.data import Bands, Images
from maniskill_grpd.rendering.kernels.outputs import Light, read_colors, read_labels, read_normals, shade_faces
from maniskill_grpd.rendering.kernels.projection import project_vertices
from maniskill_grpd.rendering.kernels.triangles import draw_triangles
from maniskill_grpd.rendering.kernels.visibility import Points, hide_points, sort_points
from maniskill_grpd.rendering.streams import warp_stream
from maniskill_grpd.rendering.triangle_scene import TriangleScene

MAX_BYTES = 8 * 2**30
"""Most memory that the images of one rasteriser may take."""
BYTES_PER_PIXEL = 8
ROWS_PER_THREAD = 4
"""Rows of an image that one thread draws on CUDA."""
MAX_CELLS = 64
"""Most cells along each side of the grid in which points are found."""
GREY = 0.7
AMBIENT, LAMP, CAMERA = 0.44, 0.46, 0.18
"""Shares of the light from everywhere, from the lamp and from the camera."""


class Rasterizer:
    """Draws C images of each of B worlds, all of the same size.

    Triangles are scan-converted into a depth buffer by one thread per image on CPU and per band of rows on CUDA. Pixel (x, y)
    shows what the ray through its centre (x + 1/2, y + 1/2) meets first between the near and the far plane. An image depends on
    its own world alone: whatever the batch, the threads and the bands, it comes out bit for bit the same.

    `draw()` draws; everything else tells of what was drawn last, `visible` also of what was looked at last with `look()`.

    Attributes:
        intrinsics: Matrices of the cameras, (C, 3, 3) [pixels]; without skew.
        extrinsics: x_camera = R x_world + t, (B, C, 3, 4) [m]; cameras look along z, x right and y down. Write into both.
        nearness: Inverse depth, (B, C, H, W) [1/m]; 1 / far where nothing is seen.
        faces: Foremost triangle, -1 for none, (B, C, H, W) int32.
    """

    def __init__(
        self,
        scene: TriangleScene,
        lens: Lens,
        intrinsics: torch.Tensor,
        extrinsics: torch.Tensor,
        *,
        num_threads: int | None = None,
    ) -> None:
        """Allocate the images.

        Args:
            scene: What to draw; its tensors are read by every `draw`.
            lens: Size of the images and range of the cameras.
            intrinsics: (C, 3, 3) [pixels].
            extrinsics: (B, C, 3, 4), or (C, 3, 4) for the same cameras in all worlds [m].
            num_threads: CPU threads that share the images; by default all cores, but at least 16 images per thread.

        Raises:
            ValueError: If a shape does not fit or the images would take more than 8 GiB.
        """
        self.scene, self.lens = scene, lens
        num, count = scene.num_worlds, len(intrinsics)
        if tuple(intrinsics.shape) != (count, 3, 3) or count < 1:
            raise ValueError(f"intrinsics must be (C >= 1, 3, 3), got {tuple(intrinsics.shape)}")
        if tuple(extrinsics.shape) not in ((num, count, 3, 4), (count, 3, 4)):
            raise ValueError(
                f"extrinsics must be {(num, count, 3, 4)} or {(count, 3, 4)} for {num} worlds and {count} cameras, "
                f"got {tuple(extrinsics.shape)}"
            )
        size = num * count * lens.height * lens.width * BYTES_PER_PIXEL
        if size > MAX_BYTES:
            raise ValueError(
                f"{num} worlds x {count} cameras of {lens.width}x{lens.height} pixels would take {size / 2**30:.1f} GiB, "
                f"more than {MAX_BYTES / 2**30:.0f}; use fewer worlds, fewer cameras or smaller images"
            )
        device = scene.device
        self.intrinsics = intrinsics.to(device, torch.float32).clone()
        self.extrinsics = extrinsics.to(device, torch.float32).expand(num, count, 3, 4).clone()
        self.nearness = torch.zeros(num, count, lens.height, lens.width, device=device)
        self.faces = torch.full_like(self.nearness, -1, dtype=torch.int32)
        self._rotations = torch.zeros(num * count, 3, 3, device=device)
        self._offsets = torch.zeros(num * count, 3, device=device)
        self._lenses = torch.zeros(count, 4, device=device)
        self._projected = torch.zeros(num * count, scene.vertices.shape[1], 3, device=device)
        with quiet_warp():
            wp.init()
            self._images = self._describe_images()
            threads = choose_num_threads(num_threads, num * count, device)
            self._projection, self._drawing = self._record_launches(threads)

    @property
    def num_images(self) -> int:
        """Number of images B C."""
        return len(self._rotations)

    def draw(self) -> None:
        """Draw what the cameras see of the scene now."""
        self.look()
        self._drawing.run()

    def look(self) -> None:
        """Find where the vertices appear in the images now; `visible` needs no more."""
        extrinsics = self.extrinsics.flatten(0, 1)
        self._rotations.copy_(extrinsics[:, :, :3])
        self._offsets.copy_(extrinsics[:, :, 3])
        self._lenses.copy_(self.intrinsics[:, [0, 1, 0, 1], [0, 1, 2, 2]])
        self._projection.run()

    def depth(self) -> torch.Tensor:
        """Return how far along the axis of the camera what is seen lies, infinity for nothing, (B, C, H, W) [m]."""
        return torch.where(self.faces >= 0, 1.0 / self.nearness, torch.inf)

    def segmentation(self) -> torch.Tensor:
        """Return what is seen, see `Label`, (B, C, H, W) int16."""
        labels = torch.empty_like(self.faces, dtype=torch.int16)
        self._launch(read_labels, self._num_rows, [wp.from_torch(labels.flatten(0, 2))])
        return labels

    def positions(self) -> torch.Tensor:
        """Return where what is seen lies in the frame of its camera, (B, C, H, W, 3) [m]; 0 for nothing."""
        depth = torch.where(self.faces >= 0, 1.0 / self.nearness, 0.0)
        fx, fy, cx, cy = (value[:, None, None] for value in self._lenses.unbind(1))
        x = (torch.arange(self.lens.width, device=depth.device) + 0.5 - cx) / fx
        y = (torch.arange(self.lens.height, device=depth.device)[:, None] + 0.5 - cy) / fy
        return torch.stack([x * depth, y * depth, depth], dim=-1)

    def normals(self) -> torch.Tensor:
        """Return unit normals of the triangles seen, on the side that is seen, in the frame of the camera; 0 for nothing.

        (B, C, H, W, 3).
        """
        normals = torch.empty(*self.faces.shape, 3, device=self.faces.device)
        self._launch(read_normals, self._num_rows, [wp.from_torch(normals.flatten(0, 2), dtype=wp.vec3)])
        return normals

    def colors(self, *, is_lit: bool = True) -> torch.Tensor:
        """Return flat-shaded pictures, lit from everywhere, by a lamp and from the camera, (B, C, H, W, 3) uint8.

        Without light they show the colours of the triangles.
        """
        scene = self.scene
        fronts = torch.full((*scene.labels.shape, 3), GREY, device=scene.device) if scene.fronts is None else scene.fronts
        backs = fronts if scene.backs is None else scene.backs
        shades = torch.empty(self.num_images, scene.triangles.shape[1], 3, device=scene.device)
        colors = torch.empty(*self.faces.shape, 3, dtype=torch.uint8, device=scene.device)
        sides = [wp.from_torch(side, dtype=wp.vec3) for side in (fronts, backs, shades)]
        light = _light(*(AMBIENT, LAMP, CAMERA) if is_lit else (1.0, 0.0, 0.0))
        self._launch(shade_faces, tuple(shades.shape[:2]), [light, *sides])
        self._launch(read_colors, self._num_rows, [sides[2], light, wp.from_torch(colors.flatten(0, 2))])
        return colors

    def visible(self, points: torch.Tensor, tolerance: float) -> torch.Tensor:
        """Tell which points the cameras see: those on their images with nothing in front of them.

        The test is exact along the ray to the point itself, whatever the size of the pixels.

        Args:
            points: (B, P, 3) float32 in the frame of each world [m]; those that are not finite are not seen.
            tolerance: How much nearer than a point something must be to hide it [m]: above the rounding of depths for points on
                the surface of a cloth, above the thickness of what surrounds the points for the axis of a rope.

        Returns:
            (B, C, P) bool.

        Raises:
            ValueError: If a shape does not fit or the tolerance is negative.
        """
        num = self.scene.num_worlds
        if points.ndim != 3 or len(points) != num or points.shape[2] != 3:
            raise ValueError(f"points must be ({num}, P, 3), got {tuple(points.shape)}")
        if not tolerance >= 0.0:
            raise ValueError(f"tolerance must be >= 0 m, got {tolerance}")
        count, device = points.shape[1], points.device
        cells = min(MAX_CELLS, max(self.lens.width, self.lens.height))
        seen = torch.empty(self.num_images, count, dtype=torch.bool, device=device)
        projected = torch.empty(self.num_images, count, 3, device=device)
        first = torch.full((self.num_images, cells * cells), -1, dtype=torch.int32, device=device)
        following = torch.empty(self.num_images, count, dtype=torch.int32, device=device)
        data = Points()
        data.places = wp.from_torch(points.to(torch.float32).contiguous(), dtype=wp.vec3)
        data.projected = wp.from_torch(projected, dtype=wp.vec3)
        data.visible, data.first, data.following = (wp.from_torch(tensor) for tensor in (seen, first, following))
        data.tolerance, data.cells = tolerance, cells
        self._launch(sort_points, (self.num_images, count), [data])
        self._launch(hide_points, (self.num_images, self.scene.triangles.shape[1]), [data])
        return seen.unflatten(0, (num, -1))

    @property
    def _num_rows(self) -> int:
        return self.num_images * self.lens.height

    def _describe_images(self) -> Images:
        scene, images = self.scene, Images()
        images.vertices = wp.from_torch(scene.vertices, dtype=wp.vec3)
        images.triangles = wp.from_torch(scene.triangles, dtype=wp.vec3i)
        images.variants, images.labels = wp.from_torch(scene.variants), wp.from_torch(scene.labels)
        images.rotations = wp.from_torch(self._rotations, dtype=wp.mat33)
        images.offsets = wp.from_torch(self._offsets, dtype=wp.vec3)
        images.lenses = wp.from_torch(self._lenses, dtype=wp.vec4)
        images.projected = wp.from_torch(self._projected, dtype=wp.vec3)
        images.nearness, images.faces = (wp.from_torch(tensor.flatten(0, 2)) for tensor in (self.nearness, self.faces))
        images.num_cameras = len(self.intrinsics)
        images.near, images.far = self.lens.near, self.lens.far
        images.width, images.height = self.lens.width, self.lens.height
        return images

    def _record_launches(self, num_threads: int) -> tuple[Launches, Launches]:
        """Record how vertices are projected and triangles drawn, by as many launches as there are threads."""
        device = self.scene.device
        rows = rows_per_thread(self.lens.height, device)
        num_bands = -(-self.lens.height // rows)
        projections, drawings = [], []
        for part in range(num_threads):
            start, end = (self.num_images * edge // num_threads for edge in (part, part + 1))
            bands = Bands()
            bands.first_image, bands.rows = start, rows
            projections.append(self._record(project_vertices, (end - start, self._projected.shape[1]), [start]))
            drawings.append(self._record(draw_triangles, (end - start, num_bands), [bands]))
        return Launches(projections, device), Launches(drawings, device)

    def _record(self, kernel: wp.Kernel, dim: tuple[int, int], inputs: list) -> wp.Launch:
        return wp.launch(kernel, dim=dim, inputs=[self._images, *inputs], device=str(self.scene.device), record_cmd=True)

    def _launch(self, kernel: wp.Kernel, dim: int | tuple[int, int], inputs: list) -> None:
        device = self.scene.device
        with quiet_warp():
            wp.launch(kernel, dim=dim, inputs=[self._images, *inputs], device=str(device), stream=warp_stream(device))


def rows_per_thread(height: int, device: torch.device) -> int:
    """Return how many rows of an image one thread draws: all on CPU, a few on CUDA, where there are many threads."""
    return height if device.type == "cpu" else min(ROWS_PER_THREAD, height)


def _light(ambient: float, lamp: float, camera: float) -> Light:
    light = Light()
    light.towards_lamp = wp.vec3(*palette.LIGHT_DIRECTION)
    light.ambient, light.lamp, light.camera = ambient, lamp, camera
    light.background = wp.vec3(*palette.BACKGROUND)
    return light
