"""What the kernels of the rasteriser work on.

Annotations stay real objects here (no postponed evaluation), because Warp reads them.
"""

import warp as wp


@wp.struct
class Images:
    """The I = B C images of C cameras in each of B worlds, camera by camera, and the triangles in them.

    Cameras look along z, x right and y down. Nearness is the inverse of z [1/m]: it is linear over the image of a triangle.
    """

    # What is drawn, in the frame of its world: V vertices, and F triangles in each of M variants.
    vertices: wp.array2d(dtype=wp.vec3)
    variants: wp.array(dtype=int)
    triangles: wp.array2d(dtype=wp.vec3i)
    labels: wp.array2d(dtype=int)
    # Cameras: x_camera = rotation x_world + offset; lens is (fx, fy, cx, cy) [pixels].
    rotations: wp.array(dtype=wp.mat33)
    offsets: wp.array(dtype=wp.vec3)
    lenses: wp.array(dtype=wp.vec4)
    num_cameras: int
    near: float
    far: float
    width: int
    height: int
    # Pixels (x, y) and nearness of the vertices, (I, V); nearness <= 0 where they are not in front of the near plane.
    projected: wp.array2d(dtype=wp.vec3)
    # Nearness of the foremost triangle and its index, -1 for none; row y of image i is row i height + y.
    nearness: wp.array2d(dtype=float)
    faces: wp.array2d(dtype=int)


@wp.struct
class Bands:
    """Which part of the images one launch draws: each of its threads draws `rows` rows of one image."""

    first_image: int
    rows: int
