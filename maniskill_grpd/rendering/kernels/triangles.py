"""Drawing triangles into the depth buffers of images."""

import warp as wp

from maniskill_grpd.rendering.kernels.data import Bands, Images
from maniskill_grpd.rendering.kernels.projection import in_front

wp.set_module_options({"enable_backward": False})

MIN_DOUBLE_AREA = wp.constant(1.0e-9)  # triangles below it are edges [pixels^2]


@wp.func
def crossing(y: float, a: wp.vec3, b: wp.vec3) -> float:
    """Return where a line at height y crosses the side from a down to b.

    Two triangles that share a side get the same number, bit for bit: no pixel between them is left out or drawn twice.
    """
    return a[0] + (y - a[1]) * ((b[0] - a[0]) / (b[1] - a[1]))


@wp.func
def first_center(at: float, count: int) -> int:
    """Return the first of `count` cells whose centre is not before a place; clamped, because places may be very far away."""
    return int(wp.ceil(wp.clamp(at - 0.5, 0.0, float(count))))


@wp.func
def fill(face: int, p: wp.vec3, q: wp.vec3, r: wp.vec3, top: int, bottom: int, first_row: int, images: Images):
    """Draw a projected triangle into the rows top ... bottom of an image, where it is the nearest."""
    a = p
    b = q
    c = r
    if a[1] > b[1]:
        a = q
        b = p
    if b[1] > c[1]:
        c = b
        b = r
        if a[1] > b[1]:
            swapped = a
            a = b
            b = swapped
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if wp.abs(area) < MIN_DOUBLE_AREA:
        return
    along_x = ((b[2] - a[2]) * (c[1] - a[1]) - (c[2] - a[2]) * (b[1] - a[1])) / area
    along_y = ((c[2] - a[2]) * (b[0] - a[0]) - (b[2] - a[2]) * (c[0] - a[0])) / area
    # Of triangles seen edge on the slopes are inexact: no pixel is nearer or farther than the corners.
    nearest = wp.max(a[2], wp.max(b[2], c[2]))
    farthest = wp.min(a[2], wp.min(b[2], c[2]))
    for row in range(wp.max(top, first_center(a[1], images.height)), wp.min(bottom, first_center(c[1], images.height))):
        y = float(row) + 0.5
        far_side = crossing(y, a, c)
        near_side = float(0.0)
        if y < b[1]:
            near_side = crossing(y, a, b)
        else:
            near_side = crossing(y, b, c)
        start = a[2] + along_y * (y - a[1])
        into = first_row + row
        left = first_center(wp.min(near_side, far_side), images.width)
        right = first_center(wp.max(near_side, far_side), images.width)
        for column in range(left, right):
            at = wp.clamp(start + along_x * (float(column) + 0.5 - a[0]), farthest, nearest)
            if at > images.nearness[into, column]:
                images.nearness[into, column] = at
                images.faces[into, column] = face


@wp.kernel
def draw_triangles(images: Images, bands: Bands):
    """Draw all triangles into a band of rows of one image, in their order: of two at the same depth the first stays."""
    part, band = wp.tid()
    image = bands.first_image + part
    top = band * bands.rows
    bottom = wp.min(top + bands.rows, images.height)
    first_row = image * images.height
    for row in range(top, bottom):
        for column in range(images.width):
            images.nearness[first_row + row, column] = 1.0 / images.far
            images.faces[first_row + row, column] = -1
    variant = images.variants[image // images.num_cameras]
    for face in range(images.triangles.shape[1]):
        corners = images.triangles[variant, face]
        shape = in_front(image, corners, images)
        if shape.count >= 3:
            fill(face, shape.p, shape.q, shape.r, top, bottom, first_row, images)
        if shape.count == 4:
            fill(face, shape.p, shape.r, shape.s, top, bottom, first_row, images)
