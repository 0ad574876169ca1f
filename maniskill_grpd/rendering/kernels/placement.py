"""From the state of a solver to the vertices of its worlds."""

import warp as wp

wp.set_module_options({"enable_backward": False})

TUBE_SIDES = wp.constant(12)
CAP_RINGS = wp.constant(3)  # rings of vertices of the round ends of tubes


@wp.struct
class Bodies:
    """K rigid bodies in each world, of V vertices in all; `basis` as in `Body`."""

    owners: wp.array(dtype=int)  # body of each vertex, (V,)
    basis: wp.array2d(dtype=wp.vec3)  # (V, 3)
    positions: wp.array2d(dtype=wp.vec3)
    rotations: wp.array2d(dtype=wp.vec4)  # unit quaternions (w, x, y, z)
    sizes: wp.array2d(dtype=wp.vec3)
    active: wp.array2d(dtype=wp.bool)


@wp.kernel
def place_bodies(bodies: Bodies, first_vertex: int, vertices: wp.array2d(dtype=wp.vec3)):
    """Place one vertex of a body; those of inactive bodies are nowhere."""
    world, vertex = wp.tid()
    body = bodies.owners[vertex]
    place = wp.vec3(wp.nan, wp.nan, wp.nan)
    if bodies.active[world, body]:
        size = bodies.sizes[world, body]
        local = size[0] * bodies.basis[vertex, 0] + size[1] * bodies.basis[vertex, 1] + size[2] * bodies.basis[vertex, 2]
        turn = bodies.rotations[world, body]
        place = wp.quat_rotate(wp.quat(turn[1], turn[2], turn[3], turn[0]), local) + bodies.positions[world, body]
    vertices[world, first_vertex + vertex] = place


@wp.func
def lay_ring(
    world: int,
    ring: int,
    center: wp.vec3,
    along: wp.vec3,
    sideways: wp.vec3,
    radius: float,
    tilt: float,
    vertices: wp.array2d(dtype=wp.vec3),
):
    """Write a ring of vertices about a point of a rope; tilted outwards by an angle it is a ring of a round end."""
    across = wp.cross(along, sideways)
    for side in range(TUBE_SIDES):
        angle = float(side) * (2.0 * wp.pi / float(TUBE_SIDES))
        around = wp.cos(angle) * sideways + wp.sin(angle) * across
        vertices[world, ring * TUBE_SIDES + side] = center + radius * (wp.cos(tilt) * around + wp.sin(tilt) * along)


@wp.func
def without(vector: wp.vec3, along: wp.vec3) -> wp.vec3:
    """Return the unit vector across a direction that is nearest to a vector."""
    across = vector - wp.dot(vector, along) * along
    return across / wp.max(wp.length(across), 1.0e-9)


@wp.kernel
def lay_tube(
    positions: wp.array2d(dtype=wp.vec3),
    variants: wp.array(dtype=int),
    counts: wp.array(dtype=int),
    radii: wp.array(dtype=float),
    vertices: wp.array2d(dtype=wp.vec3),
):
    """Lay a tube with round ends about the rope of one world, in rings that turn about it as little as possible."""
    world = wp.tid()
    count = counts[variants[world]]
    radius = radii[variants[world]]
    sideways = wp.vec3(0.0, 0.0, 0.0)
    for node in range(count):
        before = positions[world, wp.max(node - 1, 0)]
        along = wp.normalize(positions[world, wp.min(node + 1, count - 1)] - before)
        center = positions[world, node]
        if node == 0:
            axis = wp.vec3(1.0, 0.0, 0.0)
            if wp.abs(along[1]) < wp.abs(along[0]):
                axis = wp.vec3(0.0, 1.0, 0.0)
            if wp.abs(along[2]) < wp.min(wp.abs(along[0]), wp.abs(along[1])):
                axis = wp.vec3(0.0, 0.0, 1.0)
            sideways = without(axis, along)
            for ring in range(CAP_RINGS):
                tilt = -0.5 * wp.pi * (1.0 - float(ring) / float(CAP_RINGS))
                lay_ring(world, ring, center, along, sideways, radius, tilt, vertices)
        sideways = without(sideways, along)
        lay_ring(world, CAP_RINGS + node, center, along, sideways, radius, 0.0, vertices)
        if node == count - 1:
            for ring in range(CAP_RINGS):
                tilt = 0.5 * wp.pi * float(ring + 1) / float(CAP_RINGS)
                lay_ring(world, CAP_RINGS + count + ring, center, along, sideways, radius, tilt, vertices)
    nowhere = wp.vec3(wp.nan, wp.nan, wp.nan)
    for ring in range(count + 2 * CAP_RINGS, positions.shape[1] + 2 * CAP_RINGS):
        for side in range(TUBE_SIDES):
            vertices[world, ring * TUBE_SIDES + side] = nowhere
