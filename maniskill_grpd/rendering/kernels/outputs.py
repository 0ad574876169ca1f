"""What images show, read off the foremost triangles."""

import warp as wp

from maniskill_grpd.rendering.kernels.data import Images
from maniskill_grpd.rendering.kernels.projection import in_camera

wp.set_module_options({"enable_backward": False})


@wp.func
def facing_normal(image: int, face: int, images: Images) -> wp.vec4:
    """Return the unit normal of a triangle in the frame of a camera, on the side that is seen, and 1 for its front, else -1."""
    world = image // images.num_cameras
    corners = images.triangles[images.variants[world], face]
    a = in_camera(image, images.vertices[world, corners[0]], images)
    b = in_camera(image, images.vertices[world, corners[1]], images)
    c = in_camera(image, images.vertices[world, corners[2]], images)
    normal = wp.normalize(wp.cross(b - a, c - a))
    side = float(1.0)
    if wp.dot(normal, a) > 0.0:
        side = -1.0
    return wp.vec4(side * normal[0], side * normal[1], side * normal[2], side)


@wp.kernel
def read_labels(images: Images, labels: wp.array2d(dtype=wp.int16)):
    """Write what a row of an image shows; 0 for nothing."""
    row = wp.tid()
    variant = images.variants[row // images.height // images.num_cameras]
    for column in range(images.width):
        face = images.faces[row, column]
        label = int(0)
        if face >= 0:
            label = images.labels[variant, face]
        labels[row, column] = wp.int16(label)


@wp.kernel
def read_normals(images: Images, normals: wp.array2d(dtype=wp.vec3)):
    """Write the normals that a row of an image shows, in the frame of its camera; 0 for nothing."""
    row = wp.tid()
    for column in range(images.width):
        face = images.faces[row, column]
        normal = wp.vec3(0.0, 0.0, 0.0)
        if face >= 0:
            facing = facing_normal(row // images.height, face, images)
            normal = wp.vec3(facing[0], facing[1], facing[2])
        normals[row, column] = normal


@wp.struct
class Light:
    """How triangles are lit: shares of the light from everywhere, from a lamp and from the camera."""

    towards_lamp: wp.vec3  # in the frame of the world
    ambient: float
    lamp: float
    camera: float
    background: wp.vec3


@wp.kernel
def shade_faces(
    images: Images,
    light: Light,
    fronts: wp.array2d(dtype=wp.vec3),
    backs: wp.array2d(dtype=wp.vec3),
    out: wp.array2d(dtype=wp.vec3),
):
    """Write the colour of one triangle in one image, the same all over it."""
    image, face = wp.tid()
    variant = images.variants[image // images.num_cameras]
    facing = facing_normal(image, face, images)
    normal = wp.vec3(facing[0], facing[1], facing[2])
    lamp = wp.max(wp.dot(normal, images.rotations[image] * light.towards_lamp), 0.0)
    brightness = light.ambient + light.lamp * lamp + light.camera * wp.max(-normal[2], 0.0)
    color = fronts[variant, face]
    if facing[3] < 0.0:
        color = backs[variant, face]
    out[image, face] = brightness * color


@wp.kernel
def read_colors(images: Images, shades: wp.array2d(dtype=wp.vec3), light: Light, colors: wp.array3d(dtype=wp.uint8)):
    """Write the colours that a row of an image shows."""
    row = wp.tid()
    for column in range(images.width):
        face = images.faces[row, column]
        color = light.background
        if face >= 0:
            color = shades[row // images.height, face]
        for channel in range(3):
            colors[row, column, channel] = wp.uint8(wp.clamp(255.0 * color[channel] + 0.5, 0.0, 255.0))
