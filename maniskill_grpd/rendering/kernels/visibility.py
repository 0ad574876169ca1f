"""Which points no triangle hides: exact tests along the ray to each point, found through a grid of cells over the image."""

import warp as wp

from maniskill_grpd.rendering.kernels.data import Images
from maniskill_grpd.rendering.kernels.projection import in_camera, in_front, project
from maniskill_grpd.rendering.kernels.triangles import MIN_DOUBLE_AREA

wp.set_module_options({"enable_backward": False})


@wp.struct
class Points:
    """P points in each world, and those of each image by the cell in which they appear."""

    places: wp.array2d(dtype=wp.vec3)
    projected: wp.array2d(dtype=wp.vec3)  # (I, P), see Images
    visible: wp.array2d(dtype=wp.bool)
    tolerance: float
    cells: int  # along each side of an image
    first: wp.array2d(dtype=int)  # first point of each cell, -1 for none, (I, cells^2)
    following: wp.array2d(dtype=int)  # next point of the same cell, (I, P)


@wp.func
def cell_of(at: float, size: int, cells: int) -> int:
    """Return the cell of a pixel along one side of the image, clamped to the image."""
    return int(wp.clamp(wp.floor(at * float(cells) / float(size)), 0.0, float(cells - 1)))


@wp.kernel
def sort_points(images: Images, points: Points):
    """Take one point that is on the image for visible, and enter it into its cell."""
    image, point = wp.tid()
    place = in_camera(image, points.places[image // images.num_cameras, point], images)
    seen = wp.vec3(0.0, 0.0, 0.0)
    if place[2] >= images.near and place[2] <= images.far:
        seen = project(image, place, images)
    is_on = seen[2] > 0.0 and seen[0] >= 0.0 and seen[1] >= 0.0
    is_on = is_on and seen[0] < float(images.width) and seen[1] < float(images.height)
    points.projected[image, point] = seen
    points.visible[image, point] = is_on
    if is_on:
        cell = cell_of(seen[1], images.height, points.cells) * points.cells + cell_of(seen[0], images.width, points.cells)
        points.following[image, point] = wp.atomic_exch(points.first, image, cell, point)


@wp.func
def hide_behind(image: int, p: wp.vec3, q: wp.vec3, r: wp.vec3, images: Images, points: Points):
    """Mark the points that a projected triangle hides."""
    area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1])
    if wp.abs(area) < MIN_DOUBLE_AREA:
        return
    left = cell_of(wp.min(p[0], wp.min(q[0], r[0])), images.width, points.cells)
    right = cell_of(wp.max(p[0], wp.max(q[0], r[0])), images.width, points.cells)
    top = cell_of(wp.min(p[1], wp.min(q[1], r[1])), images.height, points.cells)
    bottom = cell_of(wp.max(p[1], wp.max(q[1], r[1])), images.height, points.cells)
    for y in range(top, bottom + 1):
        for x in range(left, right + 1):
            point = points.first[image, y * points.cells + x]
            while point >= 0:
                s = points.projected[image, point]
                u = ((q[0] - s[0]) * (r[1] - s[1]) - (r[0] - s[0]) * (q[1] - s[1])) / area
                v = ((r[0] - s[0]) * (p[1] - s[1]) - (p[0] - s[0]) * (r[1] - s[1])) / area
                w = 1.0 - u - v
                if u >= 0.0 and v >= 0.0 and w >= 0.0:
                    if 1.0 / (u * p[2] + v * q[2] + w * r[2]) < 1.0 / s[2] - points.tolerance:
                        points.visible[image, point] = False
                point = points.following[image, point]


@wp.kernel
def hide_points(images: Images, points: Points):
    """Mark the points that one triangle hides in one image."""
    image, face = wp.tid()
    corners = images.triangles[images.variants[image // images.num_cameras], face]
    shape = in_front(image, corners, images)
    if shape.count >= 3:
        hide_behind(image, shape.p, shape.q, shape.r, images, points)
    if shape.count == 4:
        hide_behind(image, shape.p, shape.r, shape.s, images, points)
