"""From points of the world to pixels."""

import warp as wp

from maniskill_grpd.rendering.kernels.data import Images

wp.set_module_options({"enable_backward": False})


NOWHERE = wp.constant(-1.0e9)  # nearness of vertices that are not finite


@wp.func
def in_camera(image: int, point: wp.vec3, images: Images) -> wp.vec3:
    """Return a point of the world in the frame of a camera."""
    return images.rotations[image] * point + images.offsets[image]


@wp.func
def project(image: int, point: wp.vec3, images: Images) -> wp.vec3:
    """Return pixel (x, y) and nearness of a point in the frame of a camera, which is in front of it."""
    lens = images.lenses[image % images.num_cameras]
    nearness = 1.0 / point[2]
    return wp.vec3(lens[0] * point[0] * nearness + lens[2], lens[1] * point[1] * nearness + lens[3], nearness)


@wp.kernel
def project_vertices(images: Images, first_image: int):
    """Project one vertex into one image."""
    part, vertex = wp.tid()
    image = first_image + part
    point = in_camera(image, images.vertices[image // images.num_cameras, vertex], images)
    seen = wp.vec3(0.0, 0.0, 0.0)
    if not wp.isfinite(point[2]):
        seen = wp.vec3(0.0, 0.0, NOWHERE)
    elif point[2] >= images.near:
        seen = project(image, point, images)
    images.projected[image, vertex] = seen


@wp.struct
class Polygon:
    """What of a triangle is in front of the near plane, projected: nothing, p q r, or p q r s."""

    count: int
    p: wp.vec3
    q: wp.vec3
    r: wp.vec3
    s: wp.vec3


@wp.func
def cut(image: int, inside: wp.vec3, outside: wp.vec3, images: Images) -> wp.vec3:
    """Return where a line from a point in front of the near plane to one behind it meets that plane, projected."""
    met = inside + (images.near - inside[2]) / (outside[2] - inside[2]) * (outside - inside)
    return project(image, wp.vec3(met[0], met[1], images.near), images)


@wp.func
def cut_triangle(image: int, corners: wp.vec3i, images: Images) -> Polygon:
    """Return what is in front of the near plane of a triangle that crosses it."""
    world = image // images.num_cameras
    a = in_camera(image, images.vertices[world, corners[0]], images)
    b = in_camera(image, images.vertices[world, corners[1]], images)
    c = in_camera(image, images.vertices[world, corners[2]], images)
    near = images.near
    for _turn in range(2):  # afterwards a is in front alone, or c is behind alone
        if not (a[2] >= near and c[2] < near):
            swapped = a
            a = b
            b = c
            c = swapped
    shape = Polygon()
    shape.count = 3
    shape.p = project(image, a, images)
    if b[2] >= near:
        shape.count = 4
        shape.q = project(image, b, images)
        shape.r = cut(image, b, c, images)
    else:
        shape.q = cut(image, a, b, images)
        shape.r = cut(image, a, c, images)
    shape.s = cut(image, a, c, images)
    return shape


@wp.func
def in_front(image: int, corners: wp.vec3i, images: Images) -> Polygon:
    """Return what of a triangle is in front of the near plane; nothing of one that has a corner nowhere."""
    shape = Polygon()
    shape.count = 0
    shape.p = images.projected[image, corners[0]]
    shape.q = images.projected[image, corners[1]]
    shape.r = images.projected[image, corners[2]]
    if shape.p[2] > 0.0 and shape.q[2] > 0.0 and shape.r[2] > 0.0:
        shape.count = 3
    elif shape.p[2] + shape.q[2] + shape.r[2] > 0.0:
        shape = cut_triangle(image, corners, images)
    return shape
