"""Signed distances of colliders, called by the fused kernel for one point of one world."""

import warp as wp

from maniskill_grpd.physics.colliders import ColliderKind
from maniskill_grpd.physics.kernels.data import Colliders, PlacedCollider

PLANE = wp.constant(int(ColliderKind.PLANE))
SPHERE = wp.constant(int(ColliderKind.SPHERE))
CAPSULE = wp.constant(int(ColliderKind.CAPSULE))
BOX = wp.constant(int(ColliderKind.BOX))
CYLINDER = wp.constant(int(ColliderKind.CYLINDER))
PRISM = wp.constant(int(ColliderKind.PRISM))
MESH = wp.constant(int(ColliderKind.MESH))
# Points further away than this from a mesh [m] do not feel it.
MESH_REACH = wp.constant(0.5)
# Where the bounding box of a half-space ends, and where that of a collider begins that is switched off [m].
FAR = wp.constant(1.0e9)


@wp.func
def extrude(section: wp.vec3, z: float, half_length: float) -> wp.vec4:
    """Return (normal, distance) of a cross-section (direction x, y; distance) extruded along z to +-half_length."""
    sign = float(1.0)
    if z < 0.0:
        sign = -1.0
    cap = wp.abs(z) - half_length
    side = section[2]
    if side > 0.0 and cap > 0.0:
        distance = wp.sqrt(side * side + cap * cap)
        return wp.vec4(section[0] * side / distance, section[1] * side / distance, sign * cap / distance, distance)
    if cap > side:
        return wp.vec4(0.0, 0.0, sign, cap)
    return wp.vec4(section[0], section[1], 0.0, side)


@wp.func
def disc(p: wp.vec3, radius: float) -> wp.vec3:
    """Return (direction x, y; distance) of a disc in the plane of x and y."""
    length = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    if length < 1.0e-9:
        return wp.vec3(1.0, 0.0, -radius)
    return wp.vec3(p[0] / length, p[1] / length, length - radius)


@wp.func
def polygon(p: wp.vec3, k: int, num_vertices: int, polygons: wp.array2d(dtype=wp.vec2)) -> wp.vec3:
    """Return (direction x, y; distance) of a convex counter-clockwise polygon in the plane of x and y."""
    point = wp.vec2(p[0], p[1])
    nearest = wp.vec2(0.0, 0.0)
    shortest = float(1.0e12)
    deepest = float(-1.0e12)
    out = wp.vec2(1.0, 0.0)
    for vertex in range(num_vertices):
        a = polygons[k, vertex]
        along = polygons[k, (vertex + 1) % num_vertices] - a
        offset = point - a
        normal = wp.normalize(wp.vec2(along[1], -along[0]))
        height = wp.dot(normal, offset)
        if height > deepest:
            deepest = height
            out = normal
        gap = offset - along * wp.clamp(wp.dot(offset, along) / wp.dot(along, along), 0.0, 1.0)
        if wp.length(gap) < shortest:
            shortest = wp.length(gap)
            nearest = gap
    if deepest > 0.0 and shortest > 1.0e-9:
        return wp.vec3(nearest[0] / shortest, nearest[1] / shortest, shortest)
    return wp.vec3(out[0], out[1], deepest)


@wp.func
def ball(offset: wp.vec3, radius: float) -> wp.vec4:
    """Return (normal, distance) of a sphere about the origin of `offset`."""
    length = wp.length(offset)
    if length < 1.0e-9:
        return wp.vec4(0.0, 0.0, 1.0, -radius)
    return wp.vec4(offset[0] / length, offset[1] / length, offset[2] / length, length - radius)


@wp.func
def cuboid(p: wp.vec3, half: wp.vec3) -> wp.vec4:
    """Return (normal, distance) of a box with half sizes `half`."""
    beyond = wp.vec3(wp.abs(p[0]) - half[0], wp.abs(p[1]) - half[1], wp.abs(p[2]) - half[2])
    outside = wp.vec3(wp.max(beyond[0], 0.0), wp.max(beyond[1], 0.0), wp.max(beyond[2], 0.0))
    distance = wp.length(outside)
    if distance < 1.0e-9:
        axis = int(0)
        if beyond[1] > beyond[axis]:
            axis = 1
        if beyond[2] > beyond[axis]:
            axis = 2
        outside = wp.vec3(0.0, 0.0, 0.0)
        outside[axis] = 1.0
        distance = beyond[axis]
    else:
        outside = outside / distance
    return wp.vec4(
        outside[0] * wp.where(p[0] < 0.0, -1.0, 1.0),
        outside[1] * wp.where(p[1] < 0.0, -1.0, 1.0),
        outside[2] * wp.where(p[2] < 0.0, -1.0, 1.0),
        distance,
    )


@wp.func
def triangles(p: wp.vec3, mesh: wp.uint64) -> wp.vec4:
    """Return (normal, distance) of a closed triangle mesh."""
    query = wp.mesh_query_point_sign_normal(mesh, p, MESH_REACH)
    if not query.result:
        return wp.vec4(0.0, 0.0, 1.0, MESH_REACH)
    offset = p - wp.mesh_eval_position(mesh, query.face, query.u, query.v)
    length = wp.length(offset)
    normal = wp.mesh_eval_face_normal(mesh, query.face)
    if length > 1.0e-7:
        normal = offset * (query.sign / length)
    return wp.vec4(normal[0], normal[1], normal[2], length * query.sign)


@wp.func
def place_collider(world: int, k: int, colliders: Colliders) -> PlacedCollider:
    """Fetch a collider of a world."""
    wxyz = colliders.rotations[world, k]
    collider = PlacedCollider()
    collider.index = k
    collider.kind = colliders.kinds[k]
    collider.num_vertices = colliders.polygon_sizes[k]
    collider.mesh = colliders.meshes[k]
    collider.size = colliders.sizes[world, k]
    collider.position = colliders.positions[world, k]
    collider.rotation = wp.quat(wxyz[1], wxyz[2], wxyz[3], wxyz[0])
    return collider


@wp.func
def local_distance(collider: PlacedCollider, p: wp.vec3, polygons: wp.array2d(dtype=wp.vec2)) -> wp.vec4:
    """Return (outward normal, signed distance) of a collider at a point, both in its own frame."""
    size = collider.size
    if collider.kind == PLANE:
        return wp.vec4(0.0, 0.0, 1.0, p[2])
    if collider.kind == SPHERE:
        return ball(p, size[0])
    if collider.kind == CAPSULE:
        return ball(p - wp.vec3(0.0, 0.0, wp.clamp(p[2], -size[1], size[1])), size[0])
    if collider.kind == BOX:
        return cuboid(p, size)
    if collider.kind == CYLINDER:
        return extrude(disc(p, size[0]), p[2], size[1])
    if collider.kind == PRISM:
        section = polygon(p / size[0], collider.index, collider.num_vertices, polygons)
        return extrude(wp.vec3(section[0], section[1], section[2] * size[0]), p[2], size[1])
    at = triangles(p / size[0], collider.mesh)
    return wp.vec4(at[0], at[1], at[2], at[3] * size[0])


@wp.func
def local_high(collider: PlacedCollider, high: wp.vec3) -> wp.vec3:
    """Return the upper corner of a collider's bounding box in its own frame; `high` is that of a polygon or mesh at scale 1."""
    size = collider.size
    if collider.kind == PLANE:
        return wp.vec3(FAR, FAR, 0.0)
    if collider.kind == SPHERE:
        return wp.vec3(size[0], size[0], size[0])
    if collider.kind == CAPSULE:
        return wp.vec3(size[0], size[0], size[0] + size[1])
    if collider.kind == BOX:
        return size
    if collider.kind == CYLINDER:
        return wp.vec3(size[0], size[0], size[1])
    if collider.kind == PRISM:
        return wp.vec3(high[0] * size[0], high[1] * size[0], size[1])
    return high * size[0]


@wp.func
def local_low(collider: PlacedCollider, low: wp.vec3) -> wp.vec3:
    """Return the lower corner of a collider's bounding box in its own frame; `low` is that of a polygon or mesh at scale 1."""
    if collider.kind == PLANE:
        return wp.vec3(-FAR, -FAR, -FAR)
    if collider.kind == PRISM:
        return wp.vec3(low[0] * collider.size[0], low[1] * collider.size[0], -collider.size[1])
    if collider.kind == MESH:
        return low * collider.size[0]
    return -local_high(collider, low)


@wp.func
def collider_distance(world: int, k: int, point: wp.vec3, colliders: Colliders) -> wp.vec4:
    """Return (outward normal, signed distance) of a collider at a point of its world."""
    collider = place_collider(world, k, colliders)
    at = local_distance(collider, wp.quat_rotate_inv(collider.rotation, point - collider.position), colliders.polygons)
    normal = wp.quat_rotate(collider.rotation, wp.vec3(at[0], at[1], at[2]))
    return wp.vec4(normal[0], normal[1], normal[2], at[3])
