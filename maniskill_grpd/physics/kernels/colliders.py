"""Contact with rigid obstacles: signed distances, sweeps and friction, called by the fused kernel for one point of one world."""

from typing import Any

import warp as wp

from maniskill_grpd.physics.colliders import ColliderKind
from maniskill_grpd.physics.kernels.lanes import add, choose, div, inner, lesser, mul, root, spread, sub  # noqa: F401 (operators)

PLANE = wp.constant(int(ColliderKind.PLANE))
SPHERE = wp.constant(int(ColliderKind.SPHERE))
CAPSULE = wp.constant(int(ColliderKind.CAPSULE))
BOX = wp.constant(int(ColliderKind.BOX))
CYLINDER = wp.constant(int(ColliderKind.CYLINDER))
PRISM = wp.constant(int(ColliderKind.PRISM))
MESH = wp.constant(int(ColliderKind.MESH))
# Evaluations of the signed distance along one motion; conservative advancement of a sphere needs about five.
SWEEP_STEPS = wp.constant(12)
# How close to touching a sweep stops, as a fraction of the object's radius.
SWEEP_TOLERANCE = wp.constant(0.02)
# Halvings of the stretch of an edge that is searched for the point closest to a collider.
SEARCH_STEPS = wp.constant(5)
# Closest points in this part of an edge at either end are left to its nodes.
EDGE_END = wp.constant(0.05)
# Points further away than this from a mesh [m] do not feel it.
MESH_REACH = wp.constant(0.5)


@wp.func
def resolve_contact(position: Any, previous: Any, normal: Any, depth: Any, friction: Any):
    """Push points out of a surface where their depth is positive and apply Coulomb friction to their motion within the substep.

    The normal correction `depth` is the normal impulse in position units, so the tangential motion is cancelled up to
    friction * depth: complete cancellation is stick, the rest slides (Macklin et al. 2014, section 6.1).
    """
    moved = position - previous
    tangential = moved - normal * inner(moved, normal)
    slip = root(inner(tangential, tangential))
    nothing = spread(depth, 0.0)
    cancelled = choose(slip, lesser(spread(depth, 1.0), friction * depth / slip), nothing)
    return choose(depth, position + normal * depth - tangential * cancelled, position)


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
def polygon(p: wp.vec3, collider: int, num_vertices: int, vertices: wp.array2d(dtype=wp.vec2)) -> wp.vec3:
    """Return (direction x, y; distance) of a convex counter-clockwise polygon in the plane of x and y."""
    point = wp.vec2(p[0], p[1])
    nearest = wp.vec2(0.0, 0.0)
    shortest = float(1.0e12)
    deepest = float(-1.0e12)
    out = wp.vec2(1.0, 0.0)
    for k in range(num_vertices):
        a = vertices[collider, k]
        along = vertices[collider, (k + 1) % num_vertices] - a
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
def signed_distance(
    p: wp.vec3, collider: int, kind: int, size: wp.vec3, num_vertices: int, polygons: wp.array2d(dtype=wp.vec2), mesh: wp.uint64
) -> wp.vec4:
    """Return (outward normal, signed distance) of a collider at a point in its local frame."""
    if kind == PLANE:
        return wp.vec4(0.0, 0.0, 1.0, p[2])
    if kind == SPHERE:
        return ball(p, size[0])
    if kind == CAPSULE:
        return ball(p - wp.vec3(0.0, 0.0, wp.clamp(p[2], -size[1], size[1])), size[0])
    if kind == BOX:
        return cuboid(p, size)
    if kind == CYLINDER:
        return extrude(disc(p, size[0]), p[2], size[1])
    if kind == PRISM:
        section = polygon(p / size[0], collider, num_vertices, polygons)
        return extrude(wp.vec3(section[0], section[1], section[2] * size[0]), p[2], size[1])
    at = triangles(p / size[0], mesh)
    return wp.vec4(at[0], at[1], at[2], at[3] * size[0])


@wp.func
def closest_on_edge(
    x_i: wp.vec3,
    x_j: wp.vec3,
    radius: float,
    center: wp.vec3,
    wxyz: wp.vec4,
    collider: int,
    kind: int,
    size: wp.vec3,
    num_vertices: int,
    polygons: wp.array2d(dtype=wp.vec2),
    mesh: wp.uint64,
) -> float:
    """Return the fraction t at which an edge is closest to a collider, 0 if it does not come near or an end does.

    The signed distance of a convex collider is convex along the edge: its slope (the normal along the edge) tells on which side
    the minimum lies, and bisection finds it.
    """
    rotation = wp.quat(wxyz[1], wxyz[2], wxyz[3], wxyz[0])
    start = wp.quat_rotate_inv(rotation, x_i - center)
    along = wp.quat_rotate_inv(rotation, x_j - x_i)
    at = signed_distance(start + 0.5 * along, collider, kind, size, num_vertices, polygons, mesh)
    if at[3] > radius + 0.5 * wp.length(along):
        return 0.0
    low = float(0.0)
    high = float(1.0)
    for _step in range(SEARCH_STEPS):
        middle = 0.5 * (low + high)
        at = signed_distance(start + middle * along, collider, kind, size, num_vertices, polygons, mesh)
        if at[0] * along[0] + at[1] * along[1] + at[2] * along[2] > 0.0:
            high = middle
        else:
            low = middle
    t = 0.5 * (low + high)
    if t < EDGE_END or t > 1.0 - EDGE_END:
        return 0.0
    return t


@wp.func
def project_collider(
    position: wp.vec3,
    previous: wp.vec3,
    radius: float,
    friction: float,
    center: wp.vec3,
    wxyz: wp.vec4,
    collider: int,
    kind: int,
    size: wp.vec3,
    num_vertices: int,
    polygons: wp.array2d(dtype=wp.vec2),
    mesh: wp.uint64,
) -> wp.vec3:
    """Keep a point at its radius from a collider, however far it moved in the substep.

    The motion is swept by conservative advancement: steps of the signed distance cannot miss a surface. A point that ends
    inside, or beyond the far side of a thin plate, is brought back to the tangent plane where it met the surface.
    """
    rotation = wp.quat(wxyz[1], wxyz[2], wxyz[3], wxyz[0])
    start = wp.quat_rotate_inv(rotation, previous - center)
    end = wp.quat_rotate_inv(rotation, position - center)
    motion = end - start
    travel = wp.length(motion)
    met = signed_distance(start, collider, kind, size, num_vertices, polygons, mesh)
    if met[3] - radius > travel:
        return position
    touching = radius * (1.0 + SWEEP_TOLERANCE)
    progress = float(0.0)
    for _step in range(SWEEP_STEPS):
        if met[3] > touching:
            progress += (met[3] - radius) / travel
            if progress >= 1.0:
                return position
            met = signed_distance(start + motion * progress, collider, kind, size, num_vertices, polygons, mesh)
    at = signed_distance(end, collider, kind, size, num_vertices, polygons, mesh)
    normal = wp.vec3(at[0], at[1], at[2])
    depth = radius - at[3]
    met_normal = wp.vec3(met[0], met[1], met[2])
    if wp.dot(normal, met_normal) < 0.0 or at[3] < 0.0:
        normal = met_normal
        depth = radius - (met[3] + wp.dot(met_normal, motion) * (1.0 - progress))
    if depth <= 0.0:
        return position
    return wp.quat_rotate(rotation, resolve_contact(end, start, normal, depth, friction)) + center
